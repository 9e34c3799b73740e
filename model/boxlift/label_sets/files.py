"""The two files of a labelled frame, each there whole or not at all.

    DIR/data/STEM.txt        KITTI result format, 16 columns
    DIR/details/STEM.json    one entry per prompt

Both are written from the details, rounded once, so that it makes no difference to a byte whether the
labels come from a process here or from a service.
"""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

from boxlift.formats.details import FrameDetails, ObjectDetails, kitti_object_of, kitti_text
from boxlift.formats.kitti_label import UNKNOWN_ANGLE, UNKNOWN_LOCATION, UNKNOWN_SIZE, KittiObject
from boxlift.label_sets.index import read_details
from boxlift.storage import write_whole

if TYPE_CHECKING:
    from boxlift.storage import AnyPath


def data_path(out: AnyPath, name: str) -> AnyPath:
    """Where a frame's labels are."""
    return out / "data" / f"{name}.txt"


def details_path(out: AnyPath, name: str) -> AnyPath:
    """Where a frame's details are."""
    return out / "details" / f"{name}.json"


def write_label_files(out: AnyPath, name: str, details: FrameDetails) -> str:
    """Write both files; the labels last, so that whoever finds them finds the details too.

    Returns their digest: the SHA-256 over the bytes of both, details first.
    """
    texts = (details_text(details).encode(), kitti_text(details).encode())
    for path, text in zip((details_path(out, name), data_path(out, name)), texts, strict=True):
        write_whole(path, text)
    return hashlib.sha256(b"".join(texts)).hexdigest()


def details_text(details: FrameDetails) -> str:
    """A frame's details as the JSON of its file."""
    return details.model_dump_json(by_alias=True, indent=2) + "\n"


def read_objects(path: AnyPath) -> list[KittiObject]:
    """The prompts of a details file as KITTI lines, in their order; one without a box has placeholders.

    Raises LabelFormatError.
    """
    objects = read_details(path).objects
    return [kitti_object_of(item.kitti) if item.kitti else _without_box(item) for item in objects]


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
