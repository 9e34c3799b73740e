"""Do 2D boxes hold LiDAR points where objects of their classes would be? Evidence for and against a rig.

A box's class and height in pixels say how far away its object is. Where camera and LiDAR belong together,
points inside the box lie there and those beside it do not; where the camera looks elsewhere, that is chance.
All thresholds are ours; `benchmarks/rig_check.py` measures what they lead to.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from boxlift.camera import Floats
from boxlift.frame import Frame, Prompt
from boxlift.priors import SizePrior

# Of the boxes of right rigs 0.86 to 0.98 are found to hold their object, of wrong ones 0.1: three that
# agree are enough, and more than fifty only take time.
_LEAST_BOXES, _MOST_BOXES = 3, 50
# What a detector itself doubts is too often no object: of 252 real frames with boxes of the detector in this
# package, scores from 0.3 on, six would be false alarms, and none with this.
_LEAST_SCORE = 0.5
# A box lower than this, or with fewer points, is too far away to judge.
_LEAST_BOX_PX, _LEAST_BOX_POINTS = 15, 3
# Beams are even over the columns: with so many on both sides, their absence says something.
_EXPECTED_POINTS = 10
# By how much more of a box's points than of those beside it must lie where the object would be.
_LEAST_CONTRAST = 0.3
# Several sweeps in one cloud show the ground behind an object too: points that only stand out by number.
_LEAST_UNCLEAR_SHARE = 0.08
# Whoever is hidden so far behind one other box has that one's points.
_LARGEST_COVER = 0.3
# What of a box is looked at: not its sides, not the ground below the object nor what is seen over its roof.
_INNER_COLUMNS, _INNER_ROWS = (0.2, 0.8), (0.15, 0.7)
# The strips to both sides, in widths of the box.
_BESIDE = ((-0.65, -0.15), (1.15, 1.65))


@dataclass(frozen=True)
class BoxEvidence:
    """How many boxes could be judged, how many of them hold their object, and points in the image."""

    judged: int
    holding: int
    points_in_image: int

    @property
    def confirms(self) -> bool:
        """Whether boxes and points can hardly be of different cameras."""
        return self.judged >= _LEAST_BOXES and 2 * self.holding > self.judged

    @property
    def contradicts(self) -> bool:
        """Whether boxes and points can hardly be of the same camera."""
        return self.judged >= _LEAST_BOXES and 5 * self.holding <= self.judged


def judge_boxes(frame: Frame, sizes: Mapping[str, SizePrior]) -> BoxEvidence:
    """Look into the tallest 2D boxes of a frame, as its calibration places them; see BoxEvidence."""
    points = _points_in_image(frame)
    sure = [prompt for prompt in frame.prompts if prompt.score >= _LEAST_SCORE]
    known = [prompt for prompt in sure if prompt.category in sizes and _is_whole(prompt, frame)]
    # The tallest have most points, and nothing nearer before them.
    tallest = sorted(known, key=lambda prompt: prompt.box_px[1] - prompt.box_px[3])[:_MOST_BOXES]
    focal_px = frame.calibration.focal_px[1]
    verdicts = []
    for index, prompt in enumerate(tallest):
        if _cover(prompt, tallest[:index]) <= _LARGEST_COVER:
            _, y1, _, y2 = prompt.box_px
            object_m = focal_px * sizes[prompt.category].height_m / (y2 - y1)
            verdicts.append(points.hold_object(prompt, object_m))
    judged = [verdict for verdict in verdicts if verdict is not None]
    return BoxEvidence(len(judged), sum(judged), len(points.depth_m))


@dataclass(frozen=True)
class _ImagePoints:
    """Points in the image: columns and rows in pixels, depths in metres, all (N,)."""

    column_px: Floats
    row_px: Floats
    depth_m: Floats

    def hold_object(self, prompt: Prompt, object_m: float) -> bool | None:
        """Whether more points in the box than beside it are `object_m` away; None where that is not clear."""
        x1, y1, x2, y2 = prompt.box_px
        wide, tall = x2 - x1, y2 - y1
        rows = (self.row_px >= y1 + _INNER_ROWS[0] * tall) & (self.row_px <= y1 + _INNER_ROWS[1] * tall)
        column = (self.column_px[rows] - x1) / wide
        there = np.abs(self.depth_m[rows] - object_m) < 0.15 * object_m + 1.0
        inside = there[(column >= _INNER_COLUMNS[0]) & (column <= _INNER_COLUMNS[1])]
        strips = [there[(column >= left) & (column <= right)] for left, right in _BESIDE]
        if len(inside) < _LEAST_BOX_POINTS:
            return False if min(map(len, strips)) >= _EXPECTED_POINTS else None
        # In a row of parked cars the outermost has a neighbour on one side only.
        beside = min((float(strip.mean()) for strip in strips if len(strip) >= 2), default=0.0)
        share = float(inside.mean())
        if share - beside > _LEAST_CONTRAST:
            return True
        stand_out = inside.sum() >= 5 and inside.sum() > 4 * min(map(np.sum, strips))
        return None if stand_out and share > _LEAST_UNCLEAR_SHARE else False


def _points_in_image(frame: Frame) -> _ImagePoints:
    calibration, (width, height) = frame.calibration, frame.image_size_px
    # All points at once in single precision: a third of the time, and pixels to a hundredth.
    image_P_velo = (calibration.image_P_cam @ calibration.cam_SE3_velo).astype(np.float32)
    image = frame.points_velo[:, :3] @ image_P_velo[:, :3].T + image_P_velo[:, 3]
    image = image[image[:, 2] > 0.1].astype(np.float64)
    depth_m = image[:, 2]
    column, row = image[:, :2].T / depth_m
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    return _ImagePoints(column[inside], row[inside], depth_m[inside])


def _is_whole(prompt: Prompt, frame: Frame) -> bool:
    """Whether a box is tall enough and not cut by the image's border."""
    (x1, y1, x2, y2), (width, height) = prompt.box_px, frame.image_size_px
    return 2 < x1 < x2 < width - 3 and 2 < y1 < y2 < height - 3 and y2 - y1 >= _LEAST_BOX_PX


def _inner(prompt: Prompt) -> tuple[float, float, float, float]:
    """The part of a box that is looked at, pixels."""
    x1, y1, x2, y2 = prompt.box_px
    (left, right), (top, bottom) = _INNER_COLUMNS, _INNER_ROWS
    wide, tall = x2 - x1, y2 - y1
    return x1 + left * wide, y1 + top * tall, x1 + right * wide, y1 + bottom * tall


def _cover(prompt: Prompt, nearer: Iterable[Prompt]) -> float:
    """The largest share of a box's inner part that one of the `nearer` boxes covers."""
    x1, y1, x2, y2 = _inner(prompt)
    area = (x2 - x1) * (y2 - y1)

    def overlap(box_px: Sequence[float]) -> float:
        wide = min(x2, box_px[2]) - max(x1, box_px[0])
        tall = min(y2, box_px[3]) - max(y1, box_px[1])
        return max(0.0, wide) * max(0.0, tall)

    return max((overlap(other.box_px) for other in nearer), default=0.0) / area
