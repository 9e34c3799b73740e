"""The vectorised benchmark against a slow reading of the same rules, one object after another.

The loops below follow the development kit's description step by step and share nothing with the
implementation but the pairwise IoU.
"""

from __future__ import annotations

import dataclasses
import math
from functools import cache
from typing import Literal

import numpy as np
import pytest

from boxlift.evaluation import DIFFICULTIES, Difficulty, KittiBenchmark, LabelTable
from boxlift.formats.kitti_label import KittiObject, boxes3d_of
from boxlift.overlap import bev_iou, iou_2d, iou_3d
from model.evaluation.labels_to_judge import Frames, car, dont_care

Metric = Literal["2d", "bev", "3d"]


@cache
def overlap(a: KittiObject, b: KittiObject, metric: Metric) -> float:
    if metric == "2d":
        return float(iou_2d(np.array([a.box_px]), np.array([b.box_px]))[0])
    iou = bev_iou if metric == "bev" else iou_3d
    return float(iou(boxes3d_of([a]), boxes3d_of([b]))[0])


def height_px(one: KittiObject) -> float:
    return one.box_px[3] - one.box_px[1]


def part_inside(one: KittiObject, area: KittiObject) -> float:
    (x1, y1, x2, y2), (u1, v1, u2, v2) = one.box_px, area.box_px
    shared = max(0, min(x2, u2) - max(x1, u1)) * max(0, min(y2, v2) - max(y1, v1))
    return shared / ((x2 - x1) * (y2 - y1))


def truth_role(truth: KittiObject, difficulty: Difficulty) -> str:
    too_hard = (
        truth.occluded > difficulty.max_occluded
        or truth.truncated > difficulty.max_truncated
        or height_px(truth) <= difficulty.min_height_px
    )
    if truth.category == "Car":
        return "ignored" if too_hard else "counts"
    return "ignored" if truth.category == "Van" else "absent"


def detection_role(detection: KittiObject, difficulty: Difficulty) -> str:
    if height_px(detection) < difficulty.min_height_px:
        return "ignored"
    return "counts" if detection.category == "Car" else "absent"


def score_of(detection: KittiObject) -> float:
    assert detection.score is not None
    return detection.score


def match_frame(
    truths: list[KittiObject],
    detections: list[KittiObject],
    difficulty: Difficulty,
    metric: Metric,
    min_iou: float,
    threshold: float | None,
) -> tuple[list[float], float, int]:
    """Scores of the hits, their summed orientation similarity, and the number of false detections."""
    taken: set[int] = set()
    hit_scores: list[float] = []
    similarity = 0.0
    roles = [detection_role(detection, difficulty) for detection in detections]
    seen = [
        index
        for index, detection in enumerate(detections)
        if roles[index] != "absent" and (threshold is None or score_of(detection) >= threshold)
    ]
    for truth in truths:
        if (role := truth_role(truth, difficulty)) == "absent":
            continue
        best: int | None = None
        best_value = -math.inf
        for index in seen:
            iou = overlap(truth, detections[index], metric)
            if index in taken or iou <= min_iou:
                continue
            if threshold is None:
                value = score_of(detections[index])
            else:
                value = iou if roles[index] == "counts" else -1.0
            if value > best_value:
                best, best_value = index, value
        if best is None:
            continue
        taken.add(best)
        if role == "counts" and roles[best] == "counts":
            hit_scores.append(score_of(detections[best]))
            similarity += (1 + math.cos(truth.alpha - detections[best].alpha)) / 2
    false = 0
    for index in seen:
        forgiven = metric == "2d" and any(
            area.category == "DontCare" and part_inside(detections[index], area) > min_iou for area in truths
        )
        false += roles[index] == "counts" and index not in taken and not forgiven
    return hit_scores, similarity, false


def curve_thresholds(scores: list[float], truth_count: int) -> list[float]:
    chosen: list[float] = []
    recall_wanted = 0.0
    ordered = sorted(scores, reverse=True)
    for index, score in enumerate(ordered):
        last = index == len(ordered) - 1
        here, after = (index + 1) / truth_count, (index + (1 if last else 2)) / truth_count
        if not last and after - recall_wanted < recall_wanted - here:
            continue
        chosen.append(score)
        recall_wanted += 1 / 40
    return chosen


def ap_and_aos(
    truths: Frames, detections: Frames, difficulty: Difficulty, metric: Metric, min_iou: float
) -> tuple[float, float]:
    frames = list(zip(truths, detections, strict=True))
    scores = [score for t, d in frames for score in match_frame(t, d, difficulty, metric, min_iou, None)[0]]
    count = sum(truth_role(truth, difficulty) == "counts" for frame in truths for truth in frame)
    precision, similarity = [0.0] * 41, [0.0] * 41
    for index, threshold in enumerate(curve_thresholds(scores, count)):
        matched = [match_frame(t, d, difficulty, metric, min_iou, threshold) for t, d in frames]
        hits = sum(len(hit_scores) for hit_scores, _, _ in matched)
        judged = hits + sum(false for _, _, false in matched)
        if judged:
            precision[index] = hits / judged
            similarity[index] = sum(part for _, part, _ in matched) / judged
    best = [[max(curve[index:]) for index in range(41)] for curve in (precision, similarity)]
    return 100 * sum(best[0][1:]) / 40, 100 * sum(best[1][1:]) / 40


def crowded_scenes(seed: int, frame_count: int = 80) -> tuple[Frames, Frames]:
    """Truths side by side that overlap each other, detections around them; equal scores happen."""
    rng = np.random.default_rng(seed)
    truths: Frames = []
    detections: Frames = []
    for _ in range(frame_count):
        frame_truths: list[KittiObject] = []
        frame_detections: list[KittiObject] = []
        for place in range(int(rng.integers(0, 6))):
            truth = car(
                x=1.2 * place,
                left_px=100.0 + 45.0 * place,
                height_px=float(rng.choice([24, 39, 41, 60, 90])),
                category=str(rng.choice(["Car", "Car", "Car", "Van", "Pedestrian"])),
                alpha=float(rng.uniform(-3, 3)),
                occluded=int(rng.choice([0, 0, 0, 1, 2, 3])),
                truncated=float(rng.choice([0.0, 0.0, 0.2, 0.4])),
            )
            frame_truths.append(truth)
            for _ in range(int(rng.integers(0, 4))):
                x1, y1, x2, y2 = truth.box_px
                left, up = rng.normal(0, 12), rng.normal(0, 1.5)
                x, y, z = truth.bottom_center_cam
                frame_detections.append(
                    dataclasses.replace(
                        truth,
                        category=str(rng.choice(["Car", "Car", "Car", "Pedestrian"])),
                        box_px=(x1 + left, y1 + up, x2 + left, y2 - up),
                        bottom_center_cam=(x + rng.normal(0, 0.4), y, z + rng.normal(0, 0.3)),
                        alpha=truth.alpha + rng.normal(0, 0.5),
                        score=round(float(rng.uniform(0, 1)), 1),
                    )
                )
        if rng.random() < 0.5:
            frame_truths.append(dont_care(float(rng.uniform(50, 300))))
        frame_detections = [frame_detections[i] for i in rng.permutation(len(frame_detections))]
        truths.append(frame_truths)
        detections.append(frame_detections)
    return truths, detections


@pytest.mark.parametrize("seed", range(4))
def test_same_numbers_as_one_object_after_another(seed: int) -> None:
    truths, detections = crowded_scenes(seed)
    benchmark = KittiBenchmark(LabelTable.from_frames(truths), LabelTable.from_frames(detections))
    strict, loose = (entry for entry in benchmark.average_precision("Car") if entry.recall_points == "R40")
    for index, difficulty in enumerate(DIFFICULTIES):
        expected_2d, expected_aos = ap_and_aos(truths, detections, difficulty, "2d", 0.7)
        assert 1 < expected_2d < 99, "the scene must be neither trivial nor hopeless"
        assert strict.ap_2d[index] == pytest.approx(expected_2d, abs=1e-9)
        assert strict.aos[index] == pytest.approx(expected_aos, abs=1e-9)
        expected_bev = ap_and_aos(truths, detections, difficulty, "bev", 0.5)[0]
        assert loose.ap_bev[index] == pytest.approx(expected_bev, abs=1e-9)
        expected_3d = ap_and_aos(truths, detections, difficulty, "3d", 0.7)[0]
        assert strict.ap_3d[index] == pytest.approx(expected_3d, abs=1e-9)
