from __future__ import annotations

from boxlift_client import FrameReport, Outcome, RunSummary


def report(frame: str, *warnings: tuple[str, str]) -> FrameReport:
    return FrameReport(frame, Outcome.LABELLED, warnings=warnings)


def test_no_word_of_warnings_where_there_are_none() -> None:
    summary = RunSummary()
    summary.add(report("a"))
    assert "warning" not in summary.text()


def test_the_first_frames_that_warn_are_shown_and_all_are_counted() -> None:
    summary = RunSummary()
    for name in ("e", "b", "d", "a"):
        summary.add(report(name, ("TILTED", f"The ground of {name} leans.")))
    summary.add(report("c", ("IMAGE_SIZE", "Half."), ("TILTED", "It leans.")))
    lines = summary.text().splitlines()
    start = lines.index("5 frames with warnings about the calibration:")
    assert [line.split(maxsplit=1) for line in lines[start + 1 : start + 5]] == [
        ["TILTED", "a: The ground of a leans."],
        ["TILTED", "b: The ground of b leans."],
        ["IMAGE_SIZE", "c: Half."],
        ["TILTED", "c: It leans."],
    ]
    assert lines[start + 5] == "  ... and 2 more; see the details of the frames"
