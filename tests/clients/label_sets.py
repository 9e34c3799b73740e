"""What is in a label set, but for the ledger, which tells times."""

from __future__ import annotations

from pathlib import Path

from boxlift.formats.details import FrameDetails, parse_text


def files_of(out: Path) -> dict[str, bytes]:
    """All files by their path in the set, hidden ones too."""
    paths = (path for path in out.rglob("*") if path.is_file() and path.parent.name != "ledger")
    return {path.relative_to(out).as_posix(): path.read_bytes() for path in paths}


def text_at_its_place(details: FrameDetails, written: bytes) -> str:
    """What a details file must say that holds `details`, where its camera is as `written` has it."""
    view = parse_text(written).view
    assert view is not None
    return details.model_copy(update={"view": view}).model_dump_json(by_alias=True, indent=2) + "\n"
