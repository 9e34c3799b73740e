"""KITTI tracking's label files: KITTI object lines with frame and track id before them, a file per sequence.

Truncation is a level there (0 none, 1 partly, 2 largely), not a share; levels are read as 0, .25, .75
(ours). Source: readme of the KITTI tracking development kit.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from boxlift.errors import LabelFormatError
from boxlift.formats.kitti_label import KittiObject, parse_line
from boxlift.storage import read_whole

if TYPE_CHECKING:
    from boxlift.storage import AnyPath

_SHARE_OF_LEVEL = {0.0: 0.0, 1.0: 0.25, 2.0: 0.75}
NO_TRACK = -1


@dataclass(frozen=True)
class TrackedObject:
    """One line: an object of a frame and the track that it is part of."""

    frame: int
    track: int
    line: KittiObject


def read_tracks(path: AnyPath) -> dict[int, list[TrackedObject]]:
    """Objects by frame. Raises LabelFormatError, OSError."""
    try:
        text = read_whole(path).decode()
    except UnicodeDecodeError:
        raise LabelFormatError(str(path), "the file is not text.", "Give KITTI tracking labels.") from None
    objects: dict[int, list[TrackedObject]] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        where = f"{path}:{number}"
        words = line.split(maxsplit=2)
        if not words:
            continue
        try:
            frame, track, rest = int(words[0]), int(words[1]), words[2]
        except (ValueError, IndexError):
            raise LabelFormatError(
                where, f"{line[:60]!r} begins with no frame and track.", "Give KITTI tracking labels."
            ) from None
        found = parse_line(rest, where)
        found = replace(found, truncated=_SHARE_OF_LEVEL.get(found.truncated, found.truncated))
        objects.setdefault(frame, []).append(TrackedObject(frame, track, found))
    return objects


def to_text(objects: Iterable[TrackedObject]) -> str:
    """Objects -> the text of a file; those without a track have the id -1."""
    return "".join(f"{each.frame} {each.track} {each.line.to_line()}\n" for each in objects)
