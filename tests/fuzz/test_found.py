"""Inputs that the fuzzer found once, made small: none of them does again what it did."""

from __future__ import annotations

from pathlib import Path

import pytest

from fuzz.decoders import decoders
from fuzz.trial import Trial, no_hanging

FOUND = sorted((Path(__file__).parent / "found").iterdir())


@pytest.mark.parametrize("path", FOUND, ids=lambda path: path.name)
def test_found_input(path: Path) -> None:
    """The file's name begins with the decoder's."""
    name = path.name.split("--")[0]
    with no_hanging():
        Trial(decoders()[name].decode).examine(path.read_bytes())
