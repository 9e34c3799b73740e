"""Average precision as the Waymo Open Dataset computes it.

Source: waymo_open_dataset/metrics of waymo-research/waymo-open-dataset (Sun et al., CVPR 2020), as
tools/compute_detection_metrics_main.cc configures it: score cutoffs 0, 0.01, ..., 1; a Hungarian matching per
cutoff; breakdowns by type and by range, where truths and predictions alike belong to the range of their own
centre, and match within it only; a gap in recall of more than 0.05 is filled at the precision beyond it. Its
habits are kept: a truth of any difficulty may be found at LEVEL_1, and only its own level's are missed.
Only no-label zones, which no label format here has, are unknown.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from boxlift.camera import Floats
from boxlift.errors import OptionsError
from boxlift.evaluation.label_table import Indices, Mask
from boxlift.evaluation.optimal_matching import Matches, match_at_every_cutoff
from boxlift.evaluation.sweep_table import UNKNOWN_COUNT, JudgedSweeps, SweepTable, judged_sweeps, sweep_pairs
from boxlift.formats.class_names import WAYMO_CLASSES, waymo_class
from boxlift.overlap import bev_iou, iou_3d
from boxlift.sweep import SweepLabels

DEFAULT_IOU = 0.5  # WeakM3D's table on Waymo; the benchmark's own is 0.7 for vehicles and 0.5 for the others
RANGES_M = {
    "overall": (0.0, np.inf),
    "0-30 m": (0.0, 30.0),
    "30-50 m": (30.0, 50.0),
    "50 m-inf": (50.0, np.inf),
}
LEVELS = (1, 2)

_MOST_POINTS_OF_LEVEL_2 = 5  # kDetectionLevel2NumPointsThreshold
_MAX_RECALL_STEP = 0.05  # desired_recall_delta
_RECALL_ERROR = 1e-6  # kError
# Scores are compared with the cutoffs as single precision, as in the benchmark: 0.29 reaches the cutoff 0.29.
_CUTOFFS = (np.arange(101) * 0.01).astype(np.float32).astype(np.float64)


@dataclass(frozen=True)
class WaymoPrecision:
    """Percent of one range and level; None where it has no truth.

    aph: average precision with every hit weighted by its heading, 1 where it is exact, 0 where it is turned
    round. truths: of the level; LEVEL_2 has those of LEVEL_1 too.
    """

    range: str
    level: str
    truths: int
    ap_bev: float | None
    ap_3d: float | None
    aph_bev: float | None
    aph_3d: float | None


@dataclass(frozen=True)
class WaymoEvaluation:
    """Predictions against the truth of `sweeps`, by class.

    truths_of_unknown_difficulty: truths with neither an annotator's difficulty nor a count of points; they
    are LEVEL_1. truths_without_points: left out, as the benchmark does. scores_beyond_cutoffs: predictions
    with a score outside 0 to 1: below 0 they count nowhere, above 1 as 1.
    """

    iou: float
    sweeps: JudgedSweeps
    results: dict[str, tuple[WaymoPrecision, ...]]
    truths_of_unknown_difficulty: int
    truths_without_points: int
    scores_beyond_cutoffs: int


def judge_like_waymo(
    truth: Iterable[SweepLabels], predictions: Iterable[SweepLabels], iou: float = DEFAULT_IOU
) -> WaymoEvaluation:
    """Average precision of Waymo's classes from above and in 3D, by range and level.

    truth, predictions: labels in the ego frame; sweeps are told by their names. iou: from which IoU on a
    prediction is right, in (0, 1].

    Raises OptionsError for another IoU, DatasetError where sweeps do not fit together (see judged_sweeps).
    """
    if not 0 < iou <= 1:
        raise OptionsError("iou", f"{iou:g} is no IoU to ask for.", "Give one above 0, at most 1.")
    sweeps = judged_sweeps(truth, predictions, waymo_class)
    empty = sweeps.truths.points == 0
    truths = sweeps.truths.rows(~empty)
    level = _levels(truths)
    return WaymoEvaluation(
        iou=iou,
        sweeps=sweeps,
        results={
            name: _class_results(
                truths.rows(truths.category == index),
                level[truths.category == index],
                sweeps.predictions.rows(sweeps.predictions.category == index),
                iou,
            )
            for index, name in enumerate(WAYMO_CLASSES)
        },
        truths_of_unknown_difficulty=int(
            ((truths.points == UNKNOWN_COUNT) & (truths.difficulty == UNKNOWN_COUNT)).sum()
        ),
        truths_without_points=int(empty.sum()),
        scores_beyond_cutoffs=int(((sweeps.predictions.score < 0) | (sweeps.predictions.score > 1)).sum()),
    )


def average_precision(precision: Floats, recall: Floats) -> float:
    """Area under a curve of (precision, recall) points in any order; 0 to 1.

    From high recall to low each point has the best precision so far; between points lie trapezoids, but a
    step in recall of more than 0.05 is level at first and slopes in its last 0.05 only.
    """
    by_recall: dict[float, float] = {0.0: 1.0}
    for at, value in zip(recall.tolist(), precision.tolist(), strict=True):
        by_recall[at] = max(by_recall.get(at, 0.0), value)
    curve: list[tuple[float, float]] = []
    best, last = 0.0, 0.0
    for at in sorted(by_recall, reverse=True):
        while last - at > _MAX_RECALL_STEP + _RECALL_ERROR:
            last -= _MAX_RECALL_STEP
            curve.append((best, last))
        best = max(best, by_recall[at])
        curve.append((best, at))
        last = at
    if len(curve) > 1:  # the point at recall 0 is made up: precision 1
        curve[-1] = (curve[-2][0], curve[-1][1])
    return sum((far[1] - near[1]) * (far[0] + near[0]) / 2 for far, near in pairwise(curve))


def _levels(truths: SweepTable) -> Indices:
    """(N,) 1 or 2: the annotator's, else by the points in the box."""
    few = (truths.points != UNKNOWN_COUNT) & (truths.points <= _MOST_POINTS_OF_LEVEL_2)
    level: Indices = np.where(np.isin(truths.difficulty, LEVELS), truths.difficulty, np.where(few, 2, 1))
    return level


def _class_results(
    truths: SweepTable, level: Indices, predictions: SweepTable, min_iou: float
) -> tuple[WaymoPrecision, ...]:
    pairs = _overlapping_pairs(truths, predictions, min_iou)
    results: list[WaymoPrecision] = []
    for name, (low, high) in RANGES_M.items():
        near = (low <= truths.range_3d_m) & (truths.range_3d_m < high)
        near_found = (low <= predictions.range_3d_m) & (predictions.range_3d_m < high)
        per_view = [_Counts.of(truths, level, near, predictions, near_found, *those) for those in pairs]
        for at in LEVELS:
            count = int((near & (level <= at)).sum())
            (ap_bev, aph_bev), (ap_3d, aph_3d) = (
                view.average_precisions(at) if count else (None, None) for view in per_view
            )
            results.append(WaymoPrecision(name, f"LEVEL_{at}", count, ap_bev, ap_3d, aph_bev, aph_3d))
    return tuple(results)


_Pairs = tuple[Indices, Indices, Floats]


def _overlapping_pairs(truths: SweepTable, predictions: SweepTable, min_iou: float) -> tuple[_Pairs, _Pairs]:
    """Truths, predictions and IoU (P,) of the pairs that may match: from above, and in 3D."""
    least = np.float32(min_iou)
    views: tuple[list[_Pairs], list[_Pairs]] = ([], [])
    for truth, prediction in sweep_pairs(truths, predictions):
        boxes = truths.boxes[truth], predictions.boxes[prediction]
        for view, iou in zip(views, (bev_iou(*boxes), iou_3d(*boxes)), strict=True):
            enough = iou.astype(np.float32) >= least
            view.append((truth[enough], prediction[enough], iou[enough]))
    from_above, in_3d = (
        (
            np.concatenate([part[0] for part in view]),
            np.concatenate([part[1] for part in view]),
            np.concatenate([part[2] for part in view]),
        )
        for view in views
    )
    return from_above, in_3d


@dataclass(frozen=True)
class _Counts:
    """At each cutoff (101,): predictions, hits, hits weighted by heading, hits of truths of each level."""

    predictions: Floats
    hits: Floats
    hits_by_heading: Floats
    hits_of_level: dict[int, Floats]
    truths_of_level: dict[int, int]

    @classmethod
    def of(
        cls,
        truths: SweepTable,
        level: Indices,
        near: Mask,
        predictions: SweepTable,
        near_found: Mask,
        truth: Indices,
        prediction: Indices,
        iou: Floats,
    ) -> _Counts:
        score = predictions.score.astype(np.float32).astype(np.float64)
        within = near[truth] & near_found[prediction]
        matches = match_at_every_cutoff(truth[within], prediction[within], iou[within], score)
        turned = np.abs(
            truths.boxes.rotation_y[matches.truth] - predictions.boxes.rotation_y[matches.prediction]
        )
        turned = np.minimum(turned, 2 * np.pi - turned)
        return cls(
            predictions=np.array(
                [(score[near_found] >= cutoff).sum() for cutoff in _CUTOFFS], dtype=np.float64
            ),
            hits=_at_cutoffs(matches, np.ones(len(turned))),
            hits_by_heading=_at_cutoffs(matches, 1 - turned / np.pi),
            hits_of_level={
                at: _at_cutoffs(matches, (level[matches.truth] <= at).astype(np.float64)) for at in LEVELS
            },
            truths_of_level={at: int((near & (level <= at)).sum()) for at in LEVELS},
        )

    def average_precisions(self, level: int) -> tuple[float, float]:
        """AP and APH in percent."""
        missed = self.truths_of_level[level] - self.hits_of_level[level]
        found_or_missed = self.hits + missed
        recall = np.divide(self.hits, found_or_missed, out=np.zeros_like(missed), where=found_or_missed > 0)
        ap, aph = (
            average_precision(
                np.where(
                    recall == 0,
                    1.0,
                    np.divide(gain, self.predictions, out=np.zeros_like(gain), where=self.predictions > 0),
                ),
                recall,
            )
            for gain in (self.hits, self.hits_by_heading)
        )
        return 100 * ap, 100 * aph


def _at_cutoffs(matches: Matches, weight: Floats) -> Floats:
    """(101,) sum of the weights of the matches that hold at each cutoff."""
    change = np.zeros(len(_CUTOFFS) + 1)
    np.add.at(change, np.searchsorted(_CUTOFFS, matches.above, side="right"), weight)
    np.add.at(change, np.searchsorted(_CUTOFFS, matches.up_to, side="right"), -weight)
    return np.cumsum(change)[:-1]
