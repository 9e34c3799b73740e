"""Files that name frames."""

from __future__ import annotations

from pathlib import Path

from boxlift.errors import OptionsError


def read_frames(path: Path) -> list[str]:
    """Names of frames: one a line, or the first column of a CSV (its header `frame` is skipped).

    Raises OptionsError where the file cannot be read or names nothing.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise OptionsError(
            "frames", f"{str(path)!r} cannot be read ({error}).", "Give a text file, one frame a line."
        ) from None
    names = [line.split(",")[0].strip() for line in text.splitlines()]
    if names and names[0] == "frame":
        names = names[1:]
    names = [name for name in names if name]
    if not names:
        raise OptionsError("frames", f"{str(path)!r} names no frame.", "Write one frame a line.")
    return names
