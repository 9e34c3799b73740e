"""The two files of a labelled frame, each there whole or not at all.

    DIR/data/STEM.txt        KITTI result format, 16 columns
    DIR/details/STEM.json    one entry per prompt

Both are written from the details, rounded once, so that it makes no difference to a byte whether the
labels come from a process here or from a service.
"""

from __future__ import annotations

import os
import threading
from pathlib import Path

from pydantic import ValidationError

from boxlift.errors import LabelFormatError
from boxlift.formats.details import FrameDetails, ObjectDetails, kitti_object_of, kitti_text, parse_text
from boxlift.formats.kitti_label import UNKNOWN_ANGLE, UNKNOWN_LOCATION, UNKNOWN_SIZE, KittiObject


def data_path(out: Path, name: str) -> Path:
    """Where a frame's labels are."""
    return out / "data" / f"{name}.txt"


def details_path(out: Path, name: str) -> Path:
    """Where a frame's details are."""
    return out / "details" / f"{name}.json"


def write_label_files(out: Path, name: str, details: FrameDetails) -> None:
    """Write both files; the labels last, so that whoever finds them finds the details too."""
    _write_atomically(details_path(out, name), details_text(details))
    _write_atomically(data_path(out, name), kitti_text(details))


def details_text(details: FrameDetails) -> str:
    """A frame's details as the JSON of its file."""
    return details.model_dump_json(by_alias=True, indent=2) + "\n"


def read_objects(path: Path) -> list[KittiObject]:
    """The prompts of a details file as KITTI lines, in their order; one without a box has placeholders.

    Raises LabelFormatError.
    """
    try:
        details = parse_text(path.read_bytes())
    except ValidationError as error:
        problem = f"the file holds no details of boxlift ({error.errors()[0]['msg']})."
        raise LabelFormatError(str(path), problem, "Label the frame again.") from None
    return [kitti_object_of(item.kitti) if item.kitti else _without_box(item) for item in details.objects]


def _without_box(item: ObjectDetails) -> KittiObject:
    return KittiObject(
        category=item.category,
        truncated=-1.0,
        occluded=-1,
        alpha=UNKNOWN_ANGLE,
        box_px=item.prompt_box_px,
        size_hwl_m=UNKNOWN_SIZE,
        bottom_center_cam=UNKNOWN_LOCATION,
        rotation_y=UNKNOWN_ANGLE,
    )


def _write_atomically(path: Path, text: str) -> None:
    """Write beside, flush to disk, rename: a reader, or a crash, sees the old file or the new one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{path.name}.{os.getpid()}-{threading.get_ident()}.tmp")
    try:
        with beside.open("w", encoding="utf-8", newline="\n") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
    except BaseException:
        beside.unlink(missing_ok=True)
        raise
