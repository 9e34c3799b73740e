"""KITTI label files (15 columns) and result files (16, the score last).

Columns: type, truncated, occluded, alpha, x1, y1, x2, y2, height, width, length, x, y, z, rotation_y
[, score]. The location is the centre of the box's BOTTOM face in the rectified camera frame. Unknown
is -1 for truncation, occlusion and sizes, -10 for angles, -1000 for locations. Source: the KITTI object
development kit's readme (Geiger et al., CVPR 2012).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from boxlift.boxes import Boxes3D, alpha_from_rotation_y
from boxlift.errors import LabelFormatError
from boxlift.frame import FrameLabels, ObjectLabel, Prompt
from boxlift.storage import read_whole

if TYPE_CHECKING:
    from boxlift.storage import AnyPath

UNKNOWN_SIZE = (-1.0, -1.0, -1.0)
UNKNOWN_LOCATION = (-1000.0, -1000.0, -1000.0)
UNKNOWN_ANGLE = -10.0


@dataclass(frozen=True)
class KittiObject:
    """One line, in KITTI's own conventions (bottom centre; height, width, length)."""

    category: str
    truncated: float
    occluded: int
    alpha: float
    box_px: tuple[float, float, float, float]
    size_hwl_m: tuple[float, float, float]
    bottom_center_cam: tuple[float, float, float]
    rotation_y: float
    score: float | None = None

    @property
    def has_box3d(self) -> bool:
        """Whether the line has a 3D box and not the format's placeholders."""
        return min(self.size_hwl_m) > 0 and self.bottom_center_cam != UNKNOWN_LOCATION

    def to_line(self) -> str:
        """The line as KITTI writes it: two decimals, four for the score, placeholders as integers."""
        unknown = () if self.has_box3d else (*UNKNOWN_SIZE, *UNKNOWN_LOCATION, UNKNOWN_ANGLE)
        columns = [
            self.category,
            _number(self.truncated, (-1.0,)),
            str(self.occluded),
            _number(self.alpha, (UNKNOWN_ANGLE,)),
            *(_number(edge) for edge in self.box_px),
            *(_number(n, unknown) for n in (*self.size_hwl_m, *self.bottom_center_cam, self.rotation_y)),
        ]
        if self.score is not None:
            columns.append(f"{self.score:.4f}")
        return " ".join(columns)


def _number(value: float, placeholders: tuple[float, ...] = ()) -> str:
    return f"{value:.0f}" if value in placeholders else f"{value:.2f}"


def parse_line(line: str, where: str) -> KittiObject:
    """One line -> KittiObject; `where` names it in errors. Raises LabelFormatError."""
    columns = line.split()
    if len(columns) not in (15, 16):
        raise LabelFormatError(where, f"{len(columns)} columns in {line!r:.120}.", "KITTI has 15 or 16.")
    try:
        numbers = [float(column) for column in columns[1:]]
    except ValueError as error:
        raise LabelFormatError(where, f"{error} in {line!r:.120}.", "Columns 2 to 16 are numbers.") from None
    if not all(np.isfinite(numbers)):
        raise LabelFormatError(
            where, f"a number is not finite in {line!r:.120}.", "Replace NaN and infinity."
        )
    return KittiObject(
        category=columns[0],
        truncated=numbers[0],
        occluded=int(numbers[1]),
        alpha=numbers[2],
        box_px=(numbers[3], numbers[4], numbers[5], numbers[6]),
        size_hwl_m=(numbers[7], numbers[8], numbers[9]),
        bottom_center_cam=(numbers[10], numbers[11], numbers[12]),
        rotation_y=numbers[13],
        score=numbers[14] if len(numbers) == 15 else None,
    )


def parse_text(text: str, where: str) -> list[KittiObject]:
    """A whole file's text -> its objects, blank lines skipped. Raises LabelFormatError."""
    return [
        parse_line(line, f"{where}:{number}")
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip()
    ]


def read_file(path: AnyPath) -> list[KittiObject]:
    """Objects of a label or result file. Raises LabelFormatError."""
    try:
        return parse_text(read_whole(path).decode(), str(path))
    except UnicodeDecodeError:
        raise LabelFormatError(str(path), "the file is not text.", "Give a KITTI label file.") from None


def to_text(objects: Iterable[KittiObject]) -> str:
    """Objects -> the text of a file; empty for no objects."""
    return "".join(f"{label.to_line()}\n" for label in objects)


def boxes3d_of(objects: list[KittiObject]) -> Boxes3D:
    """Bottom centre and h w l -> geometric centre and l w h, for all objects (placeholders included)."""
    if not objects:
        return Boxes3D.empty()
    height, width, length = np.array([label.size_hwl_m for label in objects]).T
    center = np.array([label.bottom_center_cam for label in objects])
    center[:, 1] -= height / 2
    return Boxes3D(center, length, width, height, np.array([label.rotation_y for label in objects]))


def from_box3d(
    category: str,
    box_px: tuple[float, float, float, float],
    box: Boxes3D,
    score: float | None = None,
    truncated: float = -1.0,
    occluded: int = -1,
) -> KittiObject:
    """A box of length 1 -> KITTI's conventions; truncation and occlusion unknown unless given.

    Alpha follows from the rounded location and rotation that the file will hold.
    """
    center = box.center_cam[0]
    # Adding zero turns -0.0, which rounding can leave, into 0.0.
    x, y, z, rotation_y = np.array([center[0], box.bottom_y[0], center[2], box.rotation_y[0]]).round(2) + 0.0
    alpha = alpha_from_rotation_y(rotation_y, np.array([x, y, z])).round(2) + 0.0
    return KittiObject(
        category=category,
        truncated=truncated,
        occluded=occluded,
        alpha=float(alpha),
        box_px=box_px,
        size_hwl_m=(float(box.height_m[0]), float(box.width_m[0]), float(box.length_m[0])),
        bottom_center_cam=(float(x), float(y), float(z)),
        rotation_y=float(rotation_y),
        score=score,
    )


def object_of(label: ObjectLabel) -> KittiObject | None:
    """A prompt's label as a result line, None without a box; the 2D columns are the prompt's box."""
    if label.box is None:
        return None
    return from_box3d(label.prompt.category, label.prompt.box_px, label.box, label.score)


def objects_of(labels: FrameLabels) -> list[KittiObject]:
    """The fitted objects of a frame as result lines."""
    return [written for label in labels.objects if (written := object_of(label)) is not None]


def prompts_of(objects: Iterable[KittiObject]) -> tuple[Prompt, ...]:
    """The 2D part of label or detection lines as prompts; DontCare lines are skipped."""
    return tuple(
        Prompt(label.category, label.box_px, 1.0 if label.score is None else label.score)
        for label in objects
        if label.category != "DontCare"
    )
