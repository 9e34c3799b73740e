"""Average precision and average orientation similarity as the KITTI object benchmark computes them.

Source: evaluate_object.cpp of the KITTI object development kit (Geiger et al., CVPR 2012); R40 instead
of R11 after Simonelli et al., "Disentangling Monocular 3D Object Detection" (ICCV 2019). Its habits are
kept: 41 score thresholds near equally spaced recalls; at one threshold a truth takes the detection of
largest overlap; truths of a neighbouring class or beyond the difficulty, and detections (of whatever
class) that are too small, may match without reward or harm; false detections inside DontCare areas are
forgiven in the image only, since DontCare has no place in 3D.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np

from boxlift.boxes import Boxes3D
from boxlift.camera import Floats
from boxlift.evaluation.label_table import Indices, LabelTable, Mask, covered_by, pairs_in_frames
from boxlift.evaluation.matching import choose_in_turn
from boxlift.evaluation.rules import CLASS_RULES, DIFFICULTIES, Difficulty, IouSet, rules_of
from boxlift.overlap import bev_iou, iou_2d, iou_3d

Metric = Literal["2d", "bev", "3d"]
RecallPoints = Literal["R11", "R40"]
PerDifficulty = tuple[float | None, float | None, float | None]

_SAMPLES = 41  # N_SAMPLE_PTS
FULL_CURVE_TRUTHS = _SAMPLES
_RECALL_POINTS: dict[RecallPoints, slice] = {"R11": slice(0, None, 4), "R40": slice(1, None)}


@dataclass(frozen=True)
class AveragePrecision:
    """Percent at [easy, moderate, hard]; None where there is no truth (or, for aos, no heading).

    truths: how many had to be found. With fewer than `FULL_CURVE_TRUTHS` the samples of the benchmark's
    curve cannot all be filled, and even perfect detections stay below 100.
    """

    recall_points: RecallPoints
    iou_2d: float
    iou_bev: float
    iou_3d: float
    ap_2d: PerDifficulty
    ap_bev: PerDifficulty
    ap_3d: PerDifficulty
    aos: PerDifficulty
    truths: tuple[int, int, int]


@dataclass(frozen=True)
class _Curve:
    """Precision and orientation similarity (41,) at rising recall, each the best at that recall or above."""

    precision: Floats
    similarity: Floats

    def average(self, points: RecallPoints) -> tuple[float, float]:
        """Average precision and orientation similarity in percent."""
        chosen = _RECALL_POINTS[points]
        return 100 * float(self.precision[chosen].mean()), 100 * float(self.similarity[chosen].mean())


@dataclass(frozen=True)
class _Pairs:
    """Truths and detections of the same frame that overlap: (P,) indices and IoU."""

    truth: Indices
    detection: Indices
    iou: Floats


class KittiBenchmark:
    """Truths and detections of the same frames; overlaps are computed once and judged many times."""

    def __init__(self, truths: LabelTable, detections: LabelTable) -> None:
        self._truths = truths
        self._detections = detections
        self._pairs = _overlapping_pairs(truths, detections)
        self._dont_care_part = covered_by(detections, truths.rows(truths.is_any_of(["DontCare"])))

    def average_precision(
        self, category: str, iou_sets: Sequence[IouSet] | None = None
    ) -> tuple[AveragePrecision, ...]:
        """AP at R11 and R40 for every set of IoUs; by default the strict and the loose set of the class.

        A class without rules of its own has no neighbours and needs `iou_sets`, else OptionsError.
        AOS is left out where a detection of the class has no heading (alpha -10).
        """
        sets = rules_of(category).iou_sets if iou_sets is None else iou_sets

        @cache
        def curves(metric: Metric, min_iou: float) -> list[_Curve | None]:
            return [self._curve(category, difficulty, metric, min_iou) for difficulty in DIFFICULTIES]

        of_class = self._detections.is_any_of([category])
        has_headings = bool(self._detections.has_heading[of_class].all())
        easy, moderate, hard = (
            int(_roles_of_truths(self._truths, category, difficulty)[0].sum()) for difficulty in DIFFICULTIES
        )
        points: tuple[RecallPoints, ...] = ("R11", "R40")
        return tuple(
            AveragePrecision(
                recall_points,
                ious.iou_2d,
                ious.iou_bev,
                ious.iou_3d,
                ap_2d=_per_difficulty(curves("2d", ious.iou_2d), recall_points),
                ap_bev=_per_difficulty(curves("bev", ious.iou_bev), recall_points),
                ap_3d=_per_difficulty(curves("3d", ious.iou_3d), recall_points),
                aos=_per_difficulty(curves("2d", ious.iou_2d), recall_points, of_heading=True)
                if has_headings
                else (None, None, None),
                truths=(easy, moderate, hard),
            )
            for ious in sets
            for recall_points in points
        )

    def _curve(self, category: str, difficulty: Difficulty, metric: Metric, min_iou: float) -> _Curve | None:
        truths, detections, pairs = self._truths, self._detections, self._pairs[metric]
        truth_counts, truth_plays = _roles_of_truths(truths, category, difficulty)
        detection_counts, detection_plays = _roles_of_detections(detections, category, difficulty)
        if not truth_counts.any():
            return None
        usable = (pairs.iou > min_iou) & truth_plays[pairs.truth] & detection_plays[pairs.detection]
        truth, wish, iou = pairs.truth[usable], pairs.detection[usable], pairs.iou[usable]

        # Without a threshold each truth takes its highest score; the scores of the hits set the thresholds.
        by_score = np.lexsort((wish, -detections.score[wish], truth))
        nothing_taken = np.zeros((len(detections), 1), dtype=np.bool_)
        truth_of_row, choices = choose_in_turn(
            truth[by_score], wish[by_score], truths.frame, taken=nothing_taken
        )
        hits = _hits(truth_of_row, choices, truth_counts, detection_counts)
        thresholds = _thresholds(detections.score[choices[hits]], int(truth_counts.sum()))

        # At each threshold it takes the largest overlap, and a detection that does not count only if alone.
        counts = detection_counts[wish]
        by_overlap = np.lexsort((wish, np.where(counts, -iou, 0), ~counts, truth))
        taken = detections.score[:, None] < thresholds
        truth_of_row, choices = choose_in_turn(truth[by_overlap], wish[by_overlap], truths.frame, taken)
        hits = _hits(truth_of_row, choices, truth_counts, detection_counts)
        turned_rad = truths.alpha[truth_of_row][:, None] - detections.alpha[choices]
        true_positives = hits.sum(axis=0)
        similarity = np.where(hits, (1 + np.cos(turned_rad)) / 2, 0).sum(axis=0)
        can_be_false = detection_counts & ~((metric == "2d") & (self._dont_care_part > min_iou))
        judged = true_positives + (can_be_false[:, None] & ~taken).sum(axis=0)
        return _Curve(_best_from_here(true_positives, judged), _best_from_here(similarity, judged))


def _overlapping_pairs(truths: LabelTable, detections: LabelTable) -> dict[Metric, _Pairs]:
    truth, detection = pairs_in_frames(truths, detections)
    real = ~truths.is_any_of(["DontCare"])[truth]
    truth, detection = truth[real], detection[real]
    boxes: tuple[Boxes3D, Boxes3D] = truths.boxes[truth], detections.boxes[detection]
    ious: dict[Metric, Floats] = {
        "2d": iou_2d(truths.box_px[truth], detections.box_px[detection]),
        "bev": bev_iou(*boxes),
        "3d": iou_3d(*boxes),
    }
    return {metric: _Pairs(truth[iou > 0], detection[iou > 0], iou[iou > 0]) for metric, iou in ious.items()}


def _roles_of_truths(truths: LabelTable, category: str, difficulty: Difficulty) -> tuple[Mask, Mask]:
    """Which truths have to be found, and which may be found."""
    of_class = truths.is_any_of([category])
    neighbours = CLASS_RULES[category].neighbours if category in CLASS_RULES else ()
    return of_class & truths.counts_as(difficulty), of_class | truths.is_any_of(neighbours)


def _roles_of_detections(detections: LabelTable, category: str, difficulty: Difficulty) -> tuple[Mask, Mask]:
    """Which detections count, and which may be matched: also the small ones of every other class."""
    small = np.abs(detections.height_px) < difficulty.min_height_px
    of_class = detections.is_any_of([category])
    return of_class & ~small, of_class | small


def _hits(truth_of_row: Indices, choices: Indices, truth_counts: Mask, detection_counts: Mask) -> Mask:
    """(R, T) where a truth that counts has chosen a detection that counts."""
    hits: Mask = (choices >= 0) & truth_counts[truth_of_row][:, None] & detection_counts[choices]
    return hits


def _thresholds(hit_scores: Floats, truth_count: int) -> Floats:
    """Scores of hits nearest to the recalls 0, 1/40, 2/40, ... (at most 41, falling)."""
    scores = np.sort(hit_scores)[::-1]
    recall = np.arange(1, len(scores) + 1) / truth_count
    next_recall = np.append(recall[1:], recall[-1:])
    picked: list[int] = []
    wanted, start = 0.0, 0
    while start < len(scores) and len(picked) < _SAMPLES:
        skip = (next_recall[start:] - wanted) < (wanted - recall[start:])
        skip[-1] = False  # the lowest score is always a threshold
        picked.append(start + int(skip.argmin()))
        start = picked[-1] + 1
        wanted += 1 / (_SAMPLES - 1)
    return scores[picked]


def _best_from_here(gain: Floats | Indices, judged: Indices) -> Floats:
    """gain / judged (T,) as (41,), zero beyond T, each raised to the best at that recall or above."""
    curve = np.zeros(_SAMPLES)
    np.divide(gain, judged, out=curve[: len(gain)], where=judged > 0)
    best: Floats = np.maximum.accumulate(curve[::-1])[::-1]
    return best


def _per_difficulty(
    curves: Sequence[_Curve | None], points: RecallPoints, of_heading: bool = False
) -> PerDifficulty:
    easy, moderate, hard = (
        None if curve is None else curve.average(points)[1 if of_heading else 0] for curve in curves
    )
    return easy, moderate, hard
