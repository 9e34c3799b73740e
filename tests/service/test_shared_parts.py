from __future__ import annotations

import os
import pickle
from pathlib import Path

import pytest

from boxlift_service.bodies.shared_parts import HeldBytes, Part, SharedParts
from boxlift_service.problems import Kind, ProblemError


def open_files() -> list[str]:
    return sorted(path.name for path in Path("/proc/self/fd").iterdir())


def test_parts_come_back_by_name_and_order_also_through_a_descriptor() -> None:
    before = open_files()
    points = os.urandom(3_000_000)
    with SharedParts.of({"points": [Part(points, "p.bin")], "image": [Part(b"a"), Part(b"", "e")]}) as parts:
        assert "points" in parts
        assert "calib" not in parts
        assert (parts.count("image"), parts.size("image"), parts.count("calib")) == (2, 1, 0)
        assert parts.read("image") == (Part(b"a"), Part(b"", "e"))
        file = parts.descriptor()
        index = pickle.loads(pickle.dumps(parts.index()))
    assert len(pickle.dumps(index)) < 1000  # nothing of the data is in it
    assert index.read(file)["points"] == (Part(points, "p.bin"),)
    os.close(file)
    assert open_files() == before


def test_bytes_are_counted_while_they_are_held_and_refused_beyond_the_limit() -> None:
    held = HeldBytes(100)
    with SharedParts(held) as first, SharedParts(held) as second:
        first.write(bytes(60))
        second.write(bytes(40))
        assert held.taken == 100
        with pytest.raises(ProblemError) as caught:
            second.write(b"1")
        assert caught.value.kind is Kind.TOO_BUSY
        assert held.taken == 100
        first.close()
        assert held.taken == 40
        second.write(b"1")
    assert held.taken == 0


def test_parts_that_do_not_fit_leave_nothing_behind() -> None:
    before, held = open_files(), HeldBytes(10)
    with pytest.raises(ProblemError):
        SharedParts.of({"points": [Part(bytes(6)), Part(bytes(6))]}, held)
    assert held.taken == 0
    assert open_files() == before


def test_without_anonymous_memory_a_nameless_temporary_file_does(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "memfd_create")
    with SharedParts.of({"points": [Part(b"abc")]}) as parts:
        assert parts.read("points") == (Part(b"abc"),)
