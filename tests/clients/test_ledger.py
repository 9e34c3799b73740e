from __future__ import annotations

from pathlib import Path

import pytest

from boxlift.errors import LabelFormatError
from boxlift_client.errors import RunStoppedError
from boxlift_client.job import FrameReport, Outcome
from boxlift_client.ledger import LedgerRow, LedgerWriter, read_ledger, read_rows


class Clock:
    """Seconds that a test sets."""

    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def row(frame: str, outcome: Outcome = Outcome.LABELLED, attempt: int = 1, source: str = "a") -> LedgerRow:
    sentence = f"No, {attempt}." if outcome is Outcome.FAILED else ""
    results = (("FITTED", "."), ("TOO_FEW_POINTS", "."), ("FITTED", "."))
    report = FrameReport(frame, outcome, sentence, results, seconds=0.5, boxes=2, digest="d")
    return LedgerRow.of(report, source, attempt)


def write(folder: Path, *rows: LedgerRow) -> None:
    writer = LedgerWriter(folder)
    for each in rows:
        writer.add(each)
    writer.flush()


def test_rows_read_back(tmp_path: Path) -> None:
    written = [row("street 7"), row("b", Outcome.FAILED)]
    write(tmp_path / "ledger", *written)
    read = list(read_rows(tmp_path / "ledger"))
    assert read == written
    assert read[0].results == {"FITTED": 2, "TOO_FEW_POINTS": 1}
    assert (read[0].prompts, read[0].boxes, read[1].error) == (3, 2, "No, 1.")


def test_no_ledger_is_an_empty_one(tmp_path: Path) -> None:
    state = read_ledger(tmp_path / "ledger")
    assert (state.done, state.failed) == ({}, {})
    LedgerWriter(tmp_path / "ledger").flush()
    assert not (tmp_path / "ledger").exists()


def test_a_frame_that_was_done_once_stays_done_in_any_order(tmp_path: Path) -> None:
    write(
        tmp_path, row("a"), row("b", Outcome.FAILED), row("c", Outcome.FAILED, 2), row("d", Outcome.SKIPPED)
    )
    write(tmp_path, row("a", Outcome.FAILED, 2), row("b", attempt=2), row("c", Outcome.FAILED), row("a"))
    state = read_ledger(tmp_path)
    assert state.done == {"a": Outcome.LABELLED, "b": Outcome.LABELLED, "d": Outcome.SKIPPED}
    assert state.failed == {"c": (2, "No, 2.")}
    assert (state.prompts, state.boxes) == (9, 6)  # a is counted once
    assert (state.attempts("c"), state.attempts("a")) == (2, 0)


def test_frames_of_other_sources_are_told_apart(tmp_path: Path) -> None:
    write(tmp_path, row("a"), row("b", source="other"))
    assert read_ledger(tmp_path, "a").foreign == {"b": "other"}
    assert read_ledger(tmp_path).foreign == {}


def test_parts_come_by_time_and_seldomer_in_a_long_run(tmp_path: Path) -> None:
    clock = Clock()
    writer = LedgerWriter(tmp_path, clock)

    def parts_in(seconds: int) -> int:
        before = len(list(tmp_path.iterdir()))
        for _ in range(seconds):
            clock.now_s += 1
            writer.add(row(str(clock.now_s)))
        return len(list(tmp_path.iterdir())) - before

    assert parts_in(100) == 20  # every 5 s
    parts_in(900)
    assert 9 <= parts_in(100) <= 10  # every 10 s: a hundredth of the time so far
    clock.now_s = 1e6
    parts_in(1)
    assert parts_in(180) == 3  # never seldomer than every 60 s
    rows = len(list(read_rows(tmp_path)))
    writer.flush()
    assert len(list(read_rows(tmp_path))) == 1281 >= rows >= 1281 - 60


def test_many_rows_do_not_wait(tmp_path: Path) -> None:
    writer = LedgerWriter(tmp_path, Clock())
    for index in range(10_001):
        writer.add(row(str(index)))
    assert len(list(read_rows(tmp_path))) == 10_000


def test_a_damaged_part_is_named(tmp_path: Path) -> None:
    write(tmp_path, row("a"))
    (tmp_path / ".half.parquet.1-2.tmp").write_bytes(b"PAR1")  # a killed writer's
    assert list(read_ledger(tmp_path).done) == ["a"]
    (tmp_path / "zzz.parquet").write_bytes(b"PAR1 and then something else")
    with pytest.raises(LabelFormatError, match=r"zzz\.parquet: the part of the ledger .* Delete it"):
        read_ledger(tmp_path)


def test_rows_that_cannot_be_written_wait(tmp_path: Path) -> None:
    (tmp_path / "ledger").write_text("no folder")
    writer = LedgerWriter(tmp_path / "ledger")
    writer.add(row("a"))
    with pytest.raises(RunStoppedError, match="The ledger cannot be written"):
        writer.flush()
    (tmp_path / "ledger").unlink()
    writer.flush()
    assert list(read_ledger(tmp_path / "ledger").done) == ["a"]
