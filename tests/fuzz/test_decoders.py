"""The short form of benchmarks/fuzz_decoders.py: some hundred damaged files for each decoder."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable

import pytest

from boxlift.errors import InputError
from fuzz.decoders import decoders
from fuzz.trial import FindingError, Trial, check_traced_memory, no_hanging

INPUTS = 2500
TRACED_EVERY = 40


@pytest.mark.parametrize("name", decoders())
def test_damaged_files(name: str) -> None:
    decoder = decoders()[name]
    trial = Trial(decoder.decode)
    for index in range(INPUTS):
        data = decoder.damaged(decoder.seeds[index % len(decoder.seeds)], index)
        with no_hanging():
            trial.examine(data)
            if index % TRACED_EVERY == 0:
                check_traced_memory(decoder.decode, data)
    assert trial.tally.accepted > INPUTS // 100
    assert trial.tally.refused > INPUTS // 10


@pytest.mark.parametrize("name", decoders())
def test_whole_files_are_decoded(name: str) -> None:
    decoder = decoders()[name]
    trial = Trial(decoder.decode)
    for data in decoder.seeds:
        trial.examine(data)
    assert trial.tally.accepted == len(decoder.seeds)


def test_same_seed_same_damage() -> None:
    decoder = decoders()["png"]
    damaged = [decoder.damaged(decoder.seeds[0], 7) for _ in range(2)]
    assert damaged[0] == damaged[1] != decoder.damaged(decoder.seeds[0], 8)


def _raises(data: bytes) -> None:
    raise KeyError(data)


def _warns(_: bytes) -> None:
    warnings.warn("a word", stacklevel=1)


def _is_slow(_: bytes) -> None:
    end = time.thread_time() + 0.3
    while time.thread_time() < end:
        pass


def _hides(_: bytes) -> None:
    raise InputError("field", "RecursionError", "remedy")


def _hangs() -> None:
    while True:
        pass


def _is_large(_: bytes) -> None:
    bytearray(2**26)


@pytest.mark.parametrize(
    ("decode", "says"),
    [
        (_raises, "KeyError"),
        (_warns, "a word"),
        (_is_slow, "s \\(4 bytes\\)"),
        (_hides, "hidden"),
    ],
)
def test_what_is_a_finding(decode: Callable[[bytes], None], says: str) -> None:
    with pytest.raises(FindingError, match=says):
        Trial(decode).examine(b"data")


def test_memory_that_the_process_had_before_is_found_when_traced() -> None:
    with pytest.raises(FindingError, match=r"671\d{5} bytes of memory"):
        check_traced_memory(_is_large, b"data")


def test_hanging_is_a_finding() -> None:
    with pytest.raises(FindingError, match="more than 2 s"), no_hanging():
        _hangs()
