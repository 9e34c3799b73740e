"""Every truth against the box of its own prompt: what the tables of accurate.py are counted from."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ablation import Dataset
from boxlift import Boxes3D, Frame, LabellerSettings, ObjectLabel
from boxlift.camera import Floats
from boxlift.evaluation import CLASS_RULES, DIFFICULTIES, Difficulty, LabelTable
from boxlift.formats.kitti_label import KittiObject, boxes3d_of, object_of
from boxlift.labeller import Labeller
from boxlift.overlap import bev_iou, iou_3d

Mask = NDArray[np.bool_]
HEADER = f"{'recall':36} {'class':10} {'group':9} {'truths':>6}  bev@l  bev@s   3d@l   3d@s"


@dataclass(frozen=True, eq=False)
class Judged:
    """N truths and what became of their prompts.

    frame: (N,) names. iou_bev, iou_3d, score: (N,), 0 without a box. probability: (N, 2) of a 3D IoU above
    .5 and .7, nan without a box. points: (N,) LiDAR points in the box of the truth.
    """

    truths: LabelTable
    objects: tuple[KittiObject, ...]
    labels: tuple[ObjectLabel, ...]
    frame: NDArray[np.str_]
    iou_bev: Floats
    iou_3d: Floats
    score: Floats
    probability: Floats
    points: NDArray[np.intp]

    def counted(self, category: str, difficulty: Difficulty) -> Mask:
        """(N,) the truths of a class that a difficulty counts."""
        return self.truths.is_any_of([category]) & self.truths.counts_as(difficulty)

    def in_frames(self, names: Iterable[str]) -> Mask:
        """(N,) the truths of some frames."""
        return np.isin(self.frame, list(names))

    def recall(self, category: str, mask: Mask) -> tuple[float, ...]:
        """BEV and then 3D at the loose and the strict IoU of a class; nan where nothing is counted."""
        rules = CLASS_RULES[category]
        return tuple(
            float((values[mask] > least).mean()) if mask.any() else float("nan")
            for values in (self.iou_bev, self.iou_3d)
            for least in (rules.loose_iou, rules.strict_iou)
        )


def judge(settings: LabellerSettings, data: Dataset) -> Judged:
    """Label every frame, whose prompts are the 2D boxes of its truths that are not DontCare, in order."""
    labeller = Labeller(settings)
    objects = [[item for item in data.truths[frame.name] if item.has_box3d] for frame in data.frames]
    labels = [label for frame in data.frames for label in labeller.label(frame).objects]
    table = LabelTable.from_frames(objects)
    fitted = np.array([label.box is not None for label in labels])
    # As they are written to a file, with KITTI's two decimals.
    boxes = boxes3d_of([written for label in labels if (written := object_of(label)) is not None])
    bev, volume = np.zeros(len(labels)), np.zeros(len(labels))
    bev[fitted], volume[fitted] = (iou(table.boxes[fitted], boxes) for iou in (bev_iou, iou_3d))
    return Judged(
        truths=table,
        objects=tuple(item for of_frame in objects for item in of_frame),
        labels=tuple(labels),
        frame=np.array([data.frames[row].name for row in table.frame]),
        iou_bev=bev,
        iou_3d=volume,
        score=np.array([label.score for label in labels]),
        probability=np.array([label.iou_probability or (np.nan, np.nan) for label in labels]),
        points=np.concatenate(
            [points_in(frame, boxes3d_of(own)) for frame, own in zip(data.frames, objects, strict=True)]
        ),
    )


def print_recall(
    title: str,
    judged: Judged,
    mask: Mask,
    category: str = "Car",
    difficulties: Sequence[Difficulty] = DIFFICULTIES,
) -> None:
    """A line per difficulty that counts any truth of `mask`."""
    for difficulty in difficulties:
        counted = judged.counted(category, difficulty) & mask
        if counted.any():
            cells = "  ".join(f"{value:5.3f}" for value in judged.recall(category, counted))
            print(f"{title:36} {category:10} {difficulty.name:9} {counted.sum():6d}  {cells}")


def points_in(frame: Frame, boxes: Boxes3D) -> NDArray[np.intp]:
    """(N,) how many LiDAR points of the frame lie in each of N boxes."""
    points = frame.calibration.velo_to_cam(frame.points_velo)
    counts = np.zeros(len(boxes), dtype=np.intp)
    for row in range(len(boxes)):
        x, y, z = (points - boxes.center_cam[row]).T
        cos, sin = np.cos(boxes.rotation_y[row]), np.sin(boxes.rotation_y[row])
        counts[row] = np.count_nonzero(
            (np.abs(cos * x - sin * z) < boxes.length_m[row] / 2)
            & (np.abs(sin * x + cos * z) < boxes.width_m[row] / 2)
            & (np.abs(y) < boxes.height_m[row] / 2)
        )
    return counts
