"""Objects for evaluation tests: every frame may hold the same cars at the same places."""

from __future__ import annotations

import dataclasses

import numpy as np

from boxlift.evaluation import AveragePrecision, KittiBenchmark, LabelTable
from boxlift.formats.kitti_label import KittiObject

Frames = list[list[KittiObject]]

# As many truths as the benchmark's curve has samples: with one each, perfect detections reach 100.
FRAMES = 41


def car(
    x: float = 0.0,
    left_px: float = 100.0,
    height_px: float = 100.0,
    score: float | None = None,
    category: str = "Car",
    alpha: float = 0.5,
    occluded: int = 0,
    truncated: float = 0.0,
) -> KittiObject:
    """A car 20 m ahead and x m to the right, with an image box of its own width 150 px."""
    return KittiObject(
        category=category,
        truncated=truncated,
        occluded=occluded,
        alpha=alpha,
        box_px=(left_px, 200.0, left_px + 150.0, 200.0 + height_px),
        size_hwl_m=(1.5, 1.6, 4.0),
        bottom_center_cam=(x, 1.7, 20.0),
        rotation_y=float(alpha + np.arctan2(x, 20.0)),
        score=score,
    )


def dont_care(left_px: float) -> KittiObject:
    """A DontCare area as KITTI writes it, wide and high enough for a car."""
    return KittiObject(
        "DontCare", -1, -1, -10, (left_px, 150, left_px + 250, 350), (-1, -1, -1), (-1000, -1000, -1000), -10
    )


def found(truth: KittiObject, score: float = 0.9) -> KittiObject:
    """The perfect detection of a truth."""
    return dataclasses.replace(truth, score=score, truncated=-1, occluded=-1)


def judge(truths: Frames, detections: Frames, category: str = "Car", points: str = "R40") -> AveragePrecision:
    """AP of a class at its strict IoU."""
    benchmark = KittiBenchmark(LabelTable.from_frames(truths), LabelTable.from_frames(detections))
    strict = benchmark.average_precision(category)[:2]
    return next(entry for entry in strict if entry.recall_points == points)
