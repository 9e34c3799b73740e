"""What the shipped head learns from: rows of 2D boxes with features, and the pseudo labels of each.

The trunk is frozen, so that features are made once: of every frame in several views (mirrored, through other
lenses, zoomed, recoloured), and of every box also a little beside itself, as detectors are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from boxlift.boxes import Boxes3D
from boxlift.camera import Calibration, Floats
from boxlift.network.augmentation import Sample, augment
from boxlift.network.config import AugmentationSettings, RowSettings
from boxlift.network.frame_batches import unchanged
from boxlift.network.geometry import describe, typical_sizes
from boxlift.network.lifter import PROMPT_SCORE, rois_of
from boxlift.network.training_frames import TrainingFrame
from boxlift.overlap import bev_iou
from boxlift.seeds import seed_of

Trunk = Callable[[NDArray[np.uint8]], tuple[Tensor, Tensor, Tensor]]

_GIVEN_SHARE = 0.3
# Two labels that overlap this far in the bird's-eye view are of one object.
_SAME_OBJECT_IOU = 0.25
# Nothing nearer has its centre in the image.
_NEAREST_M = 2.0


@dataclass(frozen=True)
class Rows:
    """M rows, see Voice and Answer for the columns.

    weight (M,): of the box; is_object (M,): probability that there is an object and no surer box of it.
    """

    geometry: Tensor
    rois: Tensor
    depth_log: Tensor
    offset: Tensor
    double_angle: Tensor
    size_log: Tensor
    weight: Tensor
    is_object: Tensor

    def __len__(self) -> int:
        return len(self.weight)

    def of(self, rows: Tensor) -> Rows:
        """The rows with these indices."""
        return Rows(*(getattr(self, column.name)[rows] for column in fields(self)))

    @classmethod
    def joined(cls, parts: Sequence[Rows]) -> Rows:
        """All rows of the parts."""
        return cls(*(torch.cat([getattr(part, column.name) for part in parts]) for column in fields(cls)))


@torch.no_grad()
def rows_of_frame(
    frame: TrainingFrame, trunk: Trunk, settings: RowSettings, augmentation: AugmentationSettings, seed: int
) -> Rows:
    """All views and shifts of a frame's 2D boxes."""
    rng = np.random.default_rng(seed_of(str(seed), frame.name))
    likely = probabilities(frame)
    surest = is_surest(frame)
    parts = []
    for view in range(settings.views):
        sample = unchanged(frame)
        if view:
            sample = augment(sample, augmentation, rng)
        maps = trunk(sample.image)
        for shift in range(settings.shifts + 1):
            left = likely * (sample.targets.weight > 0)
            given = rng.random(len(left)) < _GIVEN_SHARE
            scores = np.where(given, PROMPT_SCORE, frame.score)
            boxes_px = sample.boxes_px
            if settings.drawn:
                drawn = given & (left >= settings.least_probability) & surest
                boxes_px = np.where(drawn[:, None], _as_drawn(sample), boxes_px)
            if shift:
                boxes_px = _shifted(boxes_px, sample, settings.shift_share, rng)
            parts.append(_rows(sample, maps, boxes_px, scores, left, surest, settings))
    return Rows.joined(parts)


def probabilities(frame: TrainingFrame) -> Floats:
    """(N,) how sure the labeller is of each label: its weight holds the 2D score, too."""
    likely: Floats = (frame.targets.weight / frame.score.clip(1e-6)).clip(0, 1)
    return likely


def is_surest(frame: TrainingFrame) -> NDArray[np.bool_]:
    """(N,) whether no box of higher 2D score has (nearly) the same 3D label."""
    targets = frame.targets
    length, width, height = targets.size_m.T
    boxes = Boxes3D(targets.center_cam, length, width, height, targets.rotation_y)
    surest = np.ones(len(frame.score), dtype=np.bool_)
    labelled = targets.weight > 0
    for row in np.argsort(-frame.score, kind="stable"):
        if not labelled[row]:
            continue
        before = np.flatnonzero(labelled & surest & (frame.score > frame.score[row]))
        if len(before):
            repeated = np.repeat(row, len(before))
            surest[row] = not (bev_iou(boxes[repeated], boxes[before]) > _SAME_OBJECT_IOU).any()
    return surest


def _as_drawn(sample: Sample) -> Floats:
    """(N, 4) the 2D box that a person would draw: around the whole object, as far as it is in the image."""
    targets = sample.targets
    length, width, height = targets.size_m.T
    boxes = Boxes3D(targets.center_cam, length, width, height, targets.rotation_y)
    around = boxes.project(Calibration(sample.image_P_cam, np.eye(4)))
    rows, columns = sample.image.shape[:2]
    inside = around.clip(0, np.array([columns, rows, columns, rows]) - 1)
    usable = (inside[:, 2:] - inside[:, :2] >= 2).all(1)
    drawn: Floats = np.where(usable[:, None], inside, sample.boxes_px)
    return drawn


def _shifted(boxes_px: Floats, sample: Sample, share: float, rng: np.random.Generator) -> Floats:
    sides = np.tile(boxes_px[:, 2:] - boxes_px[:, :2], 2)
    moved = boxes_px + sides * rng.normal(0, share, sides.shape).clip(-3 * share, 3 * share)
    height, width = sample.image.shape[:2]
    moved = moved.clip(0, np.array([width, height, width, height]) - 1)
    moved[:, 2:] = np.maximum(moved[:, 2:], moved[:, :2] + 2)
    shifted: Floats = moved
    return shifted


def _rows(
    sample: Sample,
    maps: tuple[Tensor, Tensor, Tensor],
    boxes_px: Floats,
    scores: Floats,
    likely: Floats,
    surest: NDArray[np.bool_],
    settings: RowSettings,
) -> Rows:
    boxes, category = torch.from_numpy(boxes_px).float(), torch.from_numpy(sample.category)
    P = torch.tensor(sample.image_P_cam, dtype=torch.float32)
    height, width = sample.image.shape[:2]
    size = torch.tensor(float(width)), torch.tensor(float(height))
    geometry = describe(boxes, category, torch.from_numpy(scores).float(), P, size)
    targets = sample.targets
    center = torch.from_numpy(targets.center_cam).float()
    projected = center @ P[:, :3].T + P[:, 3]
    depth = projected[:, 2].clamp(min=_NEAREST_M)
    low, high = boxes[:, :2], boxes[:, 2:]
    depth_log = torch.log(depth / geometry.depth_m)
    heading = torch.from_numpy(targets.rotation_y).float() - torch.atan2(center[:, 0], center[:, 2])
    sure = torch.from_numpy(likely).float()
    weight = torch.where(sure < settings.least_probability, 0.0, sure)
    weight = torch.where(depth_log.abs() > settings.largest_disagreement, 0.0, weight)
    weight = torch.where(projected[:, 2] < _NEAREST_M, 0.0, weight)
    alone = torch.from_numpy(surest)
    return Rows(
        geometry=geometry.features,
        rois=rois_of(maps, boxes).half(),
        depth_log=depth_log,
        offset=(projected[:, :2] / depth[:, None] - (low + high) / 2) / (high - low),
        double_angle=torch.stack([torch.sin(2 * heading), torch.cos(2 * heading)], 1),
        size_log=torch.log(torch.from_numpy(targets.size_m).float() / typical_sizes()[category]),
        weight=weight * torch.where(alone, 1.0, settings.duplicate_weight),
        is_object=sure * alone,
    )
