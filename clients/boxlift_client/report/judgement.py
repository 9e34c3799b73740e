"""Every box against the truth of its own prompt: which are wrong, are scores honest, what does truth lack."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from boxlift.evaluation.rules import CLASS_RULES
from boxlift.formats.details import FrameDetails, ObjectDetails, boxes3d_of_details
from boxlift.formats.kitti_label import KittiObject, boxes3d_of
from boxlift.overlap import bev_iou_matrix, iou_2d, iou_3d

# As the evaluator associates truths with prompts.
_MIN_PROMPT_IOU = 0.5
# A box that touches no truth, as surely as its score says: truth may lack it.
_SUSPECT_SCORE = 0.7
_TOUCHES = 0.05
_POINT_BINS = (0, 10, 30, 100, 300, 10**9)
_NAMED_BINS = ("0-9", "10-29", "30-99", "100-299", "300 and more")
_LEAST_HEIGHT_PX = 25


@dataclass(frozen=True)
class JudgedObject:
    """One truth and the box of its prompt. iou 0: no box."""

    frame: str
    index: int
    category: str
    probability: float
    points: int
    has_box: bool
    iou: float


@dataclass(frozen=True)
class Suspect:
    """A box that truth may lack."""

    frame: str
    index: int
    category: str
    score: float


@dataclass(frozen=True)
class ReliabilityBin:
    """Boxes whose probability is in a tenth: how often they were right."""

    predicted: float
    right: float
    boxes: int


@dataclass(frozen=True)
class PointsRow:
    """Truths with so many points in the 2D box: shares of them with a right box."""

    points: str
    truths: int
    recall_loose: float
    recall_strict: float


def judge_frame(
    details: FrameDetails, truth: Sequence[KittiObject]
) -> tuple[list[JudgedObject], list[Suspect]]:
    """Every object that has a truth (same class, 2D boxes alike), and boxes that touch none."""
    with_box3d = [each for each in truth if each.has_box3d]
    judged, used = [], set[int]()
    for item in details.objects:
        best = _truth_of(item, with_box3d, used)
        if best is None:
            continue
        used.add(best)
        iou = 0.0
        if item.box is not None:
            iou = float(iou_3d(boxes3d_of_details([item.box]), boxes3d_of([with_box3d[best]]))[0])
        probability = item.iou_probability[0] if item.iou_probability else item.score
        judged.append(
            JudgedObject(
                details.frame,
                item.index,
                item.category,
                probability,
                item.points.in_prompt,
                item.box is not None,
                iou,
            )
        )
    return judged, _suspects(details, truth)


def _truth_of(item: ObjectDetails, truth: Sequence[KittiObject], used: set[int]) -> int | None:
    own = np.array([item.prompt_box_px])
    found = [
        (float(iou_2d(own, np.array([each.box_px]))[0]), -at)
        for at, each in enumerate(truth)
        if at not in used and each.category.lower() == item.category.lower()
    ]
    best, at = max(found, default=(0.0, 0))
    return -at if best >= _MIN_PROMPT_IOU else None


def _suspects(details: FrameDetails, truth: Sequence[KittiObject]) -> list[Suspect]:
    sure = [each for each in details.objects if each.box is not None and each.score >= _SUSPECT_SCORE]
    if not sure:
        return []
    boxes = boxes3d_of_details([each.box for each in sure if each.box is not None])
    known = boxes3d_of([each for each in truth if each.has_box3d])
    touched = bev_iou_matrix(boxes, known).max(axis=1, initial=0.0) > _TOUCHES
    # Areas that nobody labelled (DontCare) hide any number of objects.
    areas = np.array([each.box_px for each in truth], dtype=np.float64).reshape(-1, 4)
    return [
        Suspect(details.frame, item.index, item.category, item.score)
        for item, is_known in zip(sure, touched.tolist(), strict=True)
        if not is_known
        and item.prompt_box_px[3] - item.prompt_box_px[1] >= _LEAST_HEIGHT_PX
        and not _covered(item, areas)
    ]


def _covered(item: ObjectDetails, areas: np.ndarray[tuple[int, int], np.dtype[np.float64]]) -> bool:
    x1, y1, x2, y2 = item.prompt_box_px
    across = np.minimum(areas[:, 2], x2) - np.maximum(areas[:, 0], x1)
    down = np.minimum(areas[:, 3], y2) - np.maximum(areas[:, 1], y1)
    shared = across.clip(0) * down.clip(0)
    return bool((shared > 0.5 * (x2 - x1) * (y2 - y1)).any())


def reliability(judged: Sequence[JudgedObject]) -> list[ReliabilityBin]:
    """Boxes by tenths of their probability of an IoU above .5, and how often that came true."""
    bins = []
    boxes = [each for each in judged if each.has_box]
    for tenth in range(10):
        here = [each for each in boxes if min(int(10 * each.probability), 9) == tenth]
        if here:
            predicted = sum(each.probability for each in here) / len(here)
            right = sum(each.iou > 0.5 for each in here) / len(here)
            bins.append(ReliabilityBin(predicted, right, len(here)))
    return bins


def recall_by_points(judged: Sequence[JudgedObject]) -> list[PointsRow]:
    """Truths by the points in their prompt; right from the class's loose and its strict IoU on."""
    rows = []
    for low, high, name in zip(_POINT_BINS, _POINT_BINS[1:], _NAMED_BINS, strict=False):
        here = [each for each in judged if low <= each.points < high and each.category in CLASS_RULES]
        if not here:
            continue
        loose = sum(each.iou > CLASS_RULES[each.category].loose_iou for each in here)
        strict = sum(each.iou > CLASS_RULES[each.category].strict_iou for each in here)
        rows.append(PointsRow(name, len(here), loose / len(here), strict / len(here)))
    return rows


def worst(judged: Sequence[JudgedObject], count: int) -> list[JudgedObject]:
    """Boxes that overlap their truth least; of the same overlap the surest first."""
    boxes = [each for each in judged if each.has_box]
    return sorted(boxes, key=lambda each: (each.iou, -each.probability, each.frame, each.index))[:count]
