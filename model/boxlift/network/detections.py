"""From NanoDet's cells to the 2D boxes of road users: all in tensor operations, so that it exports.

Boxes that lie on or inside one of higher score go; a person with a bicycle or motorcycle beneath becomes a
cyclist.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from boxlift.network.nanodet import RawDetections

# The COCO classes that are read, by their index among the 80, and what they are called here.
COCO_INDICES = {"car": 2, "bus": 5, "truck": 7, "person": 0, "bicycle": 1, "motorcycle": 3}
CLASSES = ("Car", "Truck", "Pedestrian", "Cyclist")
_CAR, _TRUCK, _PEDESTRIAN, _CYCLIST = range(len(CLASSES))
_CYCLE = len(CLASSES)  # a bicycle or motorcycle, before it is known whether somebody rides it

# All ours. Candidates beyond the best do not change what is kept on a street.
_CANDIDATES = 400
_SAME_OBJECT_IOU = 0.6
# Of a box of lower score this share may lie inside one that is kept: parts of a vehicle pass for vehicles.
_INSIDE = 0.8
# Chains of boxes, each suppressing the next, are followed this far; on real streets they reach 7.
_ROUNDS = 16
# A rider: this share of the cycle's width is under the person, whose feet reach into the cycle.
_RIDER_OVERLAP = 0.5


class Detections(NamedTuple):
    """N road users of one image, best first; categories are indices of CLASSES.

    boxes_px (N, 4) x1, y1, x2, y2; scores (N,); categories (N,).
    """

    boxes_px: Tensor
    scores: Tensor
    categories: Tensor


class RoadUsers(nn.Module):
    """Raw detections of COCO_INDICES (in their order) -> Detections with a score above `min_score`."""

    def __init__(self, min_score: float = 0.1) -> None:
        super().__init__()
        self.min_score = min_score

    def forward(self, raw: RawDetections, width_px: Tensor, height_px: Tensor) -> Detections:
        """Of one image (B = 1) of this size; boxes are clipped to it."""
        cells = torch.stack(
            [
                raw.scores[0, :, 0],
                torch.maximum(raw.scores[0, :, 1], raw.scores[0, :, 2]),
                raw.scores[0, :, 3],
                torch.zeros_like(raw.scores[0, :, 0]),
                torch.maximum(raw.scores[0, :, 4], raw.scores[0, :, 5]),
            ],
            -1,
        )
        # A tiny image has fewer cells than candidates are taken.
        cells = functional.pad(cells, (0, 0, 0, _CANDIDATES))
        boxes = functional.pad(raw.boxes_px[0], (0, 0, 0, _CANDIDATES))
        score, kind = cells.max(-1)
        score, order = score.topk(_CANDIDATES)
        # The best always stays for now: a graph cannot take the maximum of nothing.
        sure = ((score > self.min_score) | (score >= score[0])).nonzero()[:, 0]
        score, order = score[sure], order[sure]
        kind, boxes = kind[order], boxes[order]
        size = torch.stack([width_px, height_px, width_px, height_px]).to(boxes.dtype)
        boxes = torch.minimum(boxes.clamp(min=0), size)
        vehicle = kind <= _TRUCK
        group = torch.where(vehicle, 0, kind)
        shared, area = _intersections(boxes)
        iou = shared / (area[:, None] + area[None] - shared).clamp(min=1e-6)
        inside = shared / area[:, None].clamp(min=1e-6)
        same_group = group[:, None] == group[None]
        rank = torch.cumsum(torch.ones_like(score), 0)
        better = rank[:, None] > rank[None]
        rival = same_group & better & ((iou > _SAME_OBJECT_IOU) | (vehicle[:, None] & (inside > _INSIDE)))
        kept = _suppress(rival)
        boxes, kind, kept = _join_riders(boxes, kind, score, kept)
        rows = (kept & (kind != _CYCLE) & (score > self.min_score)).nonzero()[:, 0]
        return Detections(boxes[rows], score[rows], kind[rows])


def _intersections(boxes: Tensor) -> tuple[Tensor, Tensor]:
    """(N, N) areas shared by each pair and (N,) areas."""
    low = torch.maximum(boxes[:, None, :2], boxes[None, :, :2])
    high = torch.minimum(boxes[:, None, 2:], boxes[None, :, 2:])
    sides = (boxes[:, 2:] - boxes[:, :2]).clamp(min=0)
    return (high - low).clamp(min=0).prod(-1), sides.prod(-1)


def _suppress(rival: Tensor) -> Tensor:
    """Greedy suppression (N,): a row of `rival` (N, N) falls to a column that is kept itself."""
    # Rows that nobody kept suppresses are kept; repeating that follows chains down from the best.
    against = rival.to(torch.float32)
    kept = torch.ones_like(against[:, 0])
    for _ in range(_ROUNDS):
        kept = ((against @ kept[:, None])[:, 0] < 0.5).to(torch.float32)
    return kept > 0.5


def _join_riders(boxes: Tensor, kind: Tensor, score: Tensor, kept: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """A kept person over a kept cycle becomes one cyclist, whose box holds both."""
    person, cycle = kept & (kind == _PEDESTRIAN), kept & (kind == _CYCLE)
    overlap_x = torch.minimum(boxes[:, None, 2], boxes[None, :, 2]) - torch.maximum(
        boxes[:, None, 0], boxes[None, :, 0]
    )
    narrower = torch.minimum(boxes[:, 2] - boxes[:, 0], (boxes[:, 2] - boxes[:, 0])[:, None]).clamp(min=1e-6)
    feet, top, bottom = boxes[:, None, 3], boxes[None, :, 1], boxes[None, :, 3]
    # Somebody who walks in front of a parked bicycle stands below its wheels.
    height = (bottom - top).clamp(min=1e-6)
    rides = (overlap_x / narrower > _RIDER_OVERLAP) & (feet > top) & (feet < bottom + 0.15 * height)
    rides = rides & (boxes[:, None, 1] < top + 0.1 * height) & person[:, None] & cycle[None]
    # One rider for a cycle, the surest; whoever stands behind stays a pedestrian.
    rides = rides & (torch.cumsum(rides.to(torch.float32), 0) < 1.5)
    strength, partner = torch.where(rides, score[None], 0.0).max(1)
    rider = strength > 0
    wheels = boxes[partner]
    joined = torch.cat(
        [torch.minimum(boxes[:, :2], wheels[:, :2]), torch.maximum(boxes[:, 2:], wheels[:, 2:])], 1
    )
    boxes = torch.where(rider[:, None], joined, boxes)
    kind = torch.where(rider, torch.full_like(kind, _CYCLIST), kind)
    return boxes, kind, kept
