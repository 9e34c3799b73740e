"""What became of each drive of a tracked label set: OUT/tracks/DRIVE.json, written when all its frames are.

The record says of which labels the drive was tracked, so that asking whether it is done is to compare
digests, and holds the report: what the frames said one by one, and what their drive says.
"""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from boxlift.formats.details import FrameDetails
from boxlift.frame import Result
from boxlift.storage import read_whole, write_whole

if TYPE_CHECKING:
    from boxlift.storage import AnyPath
    from boxlift.tracking import TrackedObject

TRACKS = "tracks"


class DriveRecord(BaseModel):
    """One drive, before and after.

    labels: digest of the details that it was tracked from. boxes_before, boxes_after: of all frames.
    given_a_box: prompts that had none, or one that no other frame confirmed. filled: boxes where there was
    no prompt. objects: by motion. Of the objects with a box from many frames: place_m, length_m, how far
    place (of those that stand) and length differed from frame to frame before (medians of standard
    deviations; after, they do not), turned: boxes that looked to the back of what moves.
    """

    model_config = ConfigDict(frozen=True)

    drive: str
    labels: str
    frames: int
    boxes_before: int
    boxes_after: int
    given_a_box: int
    filled: int
    objects: dict[str, int]
    place_m: float | None
    length_m: float | None
    turned: int

    def text(self) -> str:
        """The text of the file."""
        return self.model_dump_json(indent=2) + "\n"


def record_path(out: AnyPath, drive: str) -> AnyPath:
    """Where a drive's record is; drives without a name are all one."""
    plain = re.sub(r"[^\w.-]", "_", drive) or "drive"
    if plain != drive and drive:
        plain += "-" + hashlib.sha256(drive.encode()).hexdigest()[:8]
    return out / TRACKS / f"{plain}.json"


def read_records(out: AnyPath) -> list[DriveRecord]:
    """The records of all drives that are there, by name; none of a label set that was not tracked."""
    records = []
    folder = out / TRACKS
    for name in sorted(path.name for path in folder.glob("*.json")):
        try:
            records.append(DriveRecord.model_validate_json(read_whole(folder / name)))
        except ValidationError:
            continue
    return records


def read_record(out: AnyPath, drive: str) -> DriveRecord | None:
    """The record of a drive; None where there is none, or one that cannot be read: it is tracked again."""
    try:
        return DriveRecord.model_validate_json(read_whole(record_path(out, drive)))
    except (FileNotFoundError, ValidationError):
        return None


def write_record(out: AnyPath, record: DriveRecord) -> None:
    """Write it. Raises OSError."""
    write_whole(record_path(out, record.drive), record.text().encode())


def labels_digest(paths: Iterable[AnyPath]) -> str:
    """SHA-256 over names and bytes of details files. Raises OSError."""
    digest = hashlib.sha256()
    for path in paths:
        digest.update(path.name.encode() + b"\0" + hashlib.sha256(read_whole(path)).digest())
    return digest.hexdigest()


class DriveCounts:
    """Counts the frames of a drive as they are written."""

    def __init__(self) -> None:
        self.frames = 0
        self._boxes = 0
        self._results: Counter[str] = Counter()

    def add(self, details: FrameDetails) -> None:
        """One frame, tracked."""
        self.frames += 1
        self._boxes += sum(each.box is not None for each in details.objects)
        self._results.update(each.result for each in details.objects if each.box is not None)

    def record(self, drive: str, labels: str, objects: Sequence[TrackedObject]) -> DriveRecord:
        """The record of the drive once all its frames are counted."""
        fused = [each for each in objects if each.fused is not None]
        standing = [each.place_spread_m for each in fused if each.path.stands]
        return DriveRecord(
            drive=drive,
            labels=labels,
            frames=self.frames,
            boxes_before=sum(len(sighting.members) for each in objects for sighting in each.track.sightings),
            boxes_after=self._boxes,
            given_a_box=self._results[Result.TRACKED.name],
            filled=self._results[Result.FILLED.name],
            objects=dict(sorted(Counter(str(each.motion) for each in objects).items())),
            place_m=_median(standing),
            length_m=_median([each.length_spread_m for each in fused]),
            turned=sum(each.turned for each in fused),
        )


def _median(values: Sequence[float]) -> float | None:
    return round(float(np.median(values)), 3) if values else None
