"""Average precision and true-positive errors as the nuScenes detection benchmark computes them.

Source: nuscenes/eval/detection of the nuScenes devkit 1.2 (Caesar et al., CVPR 2020), configuration
detection_cvpr_2019. A prediction is right that lies near enough, seen from above, to a truth that no better
prediction has taken. Its habits are kept: predictions of equal score count from the last to the first;
recall up to 0.1 and precision up to 0.1 earn nothing; a class that has not reached a recall of 0.1 has
errors of 1. Distances are measured in the ego frame, by the devkit in the global one: where the vehicle
leans they differ by as little as the leaning shortens them. Velocities are not known, so that there is
neither an AVE nor the nuScenes detection score, which needs it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from boxlift.boxes import Boxes3D, wrap_angle
from boxlift.camera import Floats
from boxlift.errors import DatasetError
from boxlift.evaluation.label_table import Indices, Mask
from boxlift.evaluation.matching import choose_in_turn
from boxlift.evaluation.sweep_table import JudgedSweeps, SweepTable, judged_sweeps, sweep_pairs
from boxlift.formats.class_names import BICYCLE_RACKS, NUSCENES_CLASSES, nuscenes_class
from boxlift.sweep import SweepLabels

DISTANCES_M = (0.5, 1.0, 2.0, 4.0)  # dist_ths
ERROR_DISTANCE_M = 2.0  # dist_th_tp
CLASS_RANGES_M = dict(zip(NUSCENES_CLASSES, (50, 50, 50, 50, 50, 40, 40, 40, 30, 30), strict=True))

_MIN_RECALL = 0.1
_MIN_PRECISION = 0.1
_MOST_PER_SWEEP = 500  # max_boxes_per_sample
_RECALLS = np.linspace(0, 1, 101)
_FIRST_RECALL = round(100 * _MIN_RECALL) + 1  # the first that counts
_ERRORS = ("ate", "ase", "aoe", "aae")
_WITHOUT_HEADING = ("traffic_cone",)
_ALIKE_FROM_BEHIND = ("barrier",)
_WITHOUT_ATTRIBUTES = ("traffic_cone", "barrier")
_IN_RACKS = ("bicycle", "motorcycle")
_RACK = len(NUSCENES_CLASSES)


@dataclass(frozen=True)
class NuscenesErrors:
    """Mean errors of the predictions that are right at 2 m, averaged over the recalls above 0.1.

    ate: metres between the centres, seen from above. ase: 1 - IoU of the boxes laid on each other. aoe:
    radians. aae: part of wrong attributes. None: the class has no such thing, or nobody says it.
    """

    ate: float | None
    ase: float | None
    aoe: float | None
    aae: float | None


@dataclass(frozen=True)
class NuscenesPrecision:
    """One class: truths in range, average precision in percent and the errors.

    ap: mean of ap_at_m, by distance in metres. None where there is no truth.
    """

    truths: int
    ap: float | None
    ap_at_m: dict[str, float | None]
    errors: NuscenesErrors


@dataclass(frozen=True)
class NuscenesMeans:
    """Mean over classes: average precision in percent, and errors."""

    classes: int
    ap: float | None
    errors: NuscenesErrors


@dataclass(frozen=True)
class NuscenesEvaluation:
    """Predictions against the truth, by class.

    means: over the classes that have a truth. means_of_ten: the benchmark's own, over all ten; a class
    without truth counts there as not found (AP 0, errors 1). attributes_known: whether any prediction
    has one.
    """

    sweeps: JudgedSweeps
    results: dict[str, NuscenesPrecision]
    means: NuscenesMeans
    means_of_ten: NuscenesMeans
    attributes_known: bool


def judge_like_nuscenes(
    truth: Iterable[SweepLabels], predictions: Iterable[SweepLabels]
) -> NuscenesEvaluation:
    """Average precision by distance, and errors, of nuScenes' ten classes.

    truth, predictions: labels in the ego frame; sweeps are told by their names. Truths without points, and
    whatever lies beyond the range of its class, are left out; so are bicycles and motorcycles in the bicycle
    racks of the truth.

    Raises DatasetError where sweeps do not fit together (see judged_sweeps), where a sweep has more than 500
    predictions and where a box has no size.
    """
    sweeps = judged_sweeps(truth, predictions, _class_or_rack)
    racks = sweeps.truths.rows(sweeps.truths.category == _RACK)
    truths = _in_range(sweeps.truths, racks)
    truths = truths.rows(truths.points != 0)
    of_class = sweeps.predictions.rows(sweeps.predictions.category != _RACK)
    most = int(np.bincount(of_class.sweep, minlength=1).max())
    if most > _MOST_PER_SWEEP:
        raise DatasetError(
            "pred",
            f"a sweep has {most} predictions; nuScenes allows {_MOST_PER_SWEEP}.",
            "Keep the best ones.",
        )
    found = _in_range(of_class, racks)
    for field, table in (("gt", truths), ("pred", found)):
        if len(table) and min(side.min() for side in _sizes_m(table.boxes).T) <= 0:
            raise DatasetError(field, "there is a box without size.", "Leave it out.")
    attributes_known = bool((found.attribute != "").any())
    results = {
        name: _judge(
            name, truths.rows(truths.category == index), found.rows(found.category == index), attributes_known
        )
        for index, name in enumerate(NUSCENES_CLASSES)
    }
    return NuscenesEvaluation(
        sweeps=sweeps,
        results=results,
        means=_means([each for each in results.values() if each.truths]),
        means_of_ten=_means([_as_not_found(name, each, attributes_known) for name, each in results.items()]),
        attributes_known=attributes_known,
    )


def _class_or_rack(name: str) -> int | None:
    return _RACK if name.lower() in BICYCLE_RACKS else nuscenes_class(name)


def _in_range(table: SweepTable, racks: SweepTable) -> SweepTable:
    """Without racks, and without what nuScenes does not judge for its place."""
    table = table.rows(table.category != _RACK)
    ranges_m = np.array([CLASS_RANGES_M[name] for name in NUSCENES_CLASSES], dtype=np.float64)
    keep = table.range_xy_m < ranges_m[table.category]
    may_be_in_rack = np.isin(table.category, [NUSCENES_CLASSES.index(name) for name in _IN_RACKS])
    for rack, inside in sweep_pairs(racks, table):
        apart = table.boxes.center_cam[inside] - racks.boxes.center_cam[rack]
        cos, sin = np.cos(racks.boxes.rotation_y[rack]), np.sin(racks.boxes.rotation_y[rack])
        along, across = cos * apart[:, 0] - sin * apart[:, 2], sin * apart[:, 0] + cos * apart[:, 2]
        offset = np.abs(np.stack([along, across, apart[:, 1]], axis=1))
        within = (offset <= _sizes_m(racks.boxes)[rack] / 2).all(axis=1)
        keep[inside[within]] &= ~may_be_in_rack[inside[within]]
    return table.rows(keep)


def _sizes_m(boxes: Boxes3D) -> Floats:
    """(N, 3) length, width, height."""
    sizes: Floats = np.stack([boxes.length_m, boxes.width_m, boxes.height_m], axis=1)
    return sizes


def _judge(name: str, truths: SweepTable, found: SweepTable, attributes_known: bool) -> NuscenesPrecision:
    if len(truths) == 0:
        none = NuscenesErrors(None, None, None, None)
        return NuscenesPrecision(0, None, {f"{each:g}": None for each in DISTANCES_M}, none)
    # Best first; of equal scores the last first, as the devkit sorts.
    found = found.rows(np.lexsort((-np.arange(len(found)), -found.score)))
    in_turn = np.argsort(found.sweep, kind="stable")
    chooser, nearest, distances_m = _near_pairs(truths, found.rows(in_turn))
    ap_at_m: dict[str, float] = {}
    errors = NuscenesErrors(1.0, 1.0, 1.0, 1.0)
    for distance_m in DISTANCES_M:
        near = distances_m < distance_m
        match = np.full(len(found), -1)
        match[in_turn] = _matches(len(truths), found.sweep[in_turn], chooser[near], nearest[near])
        curve = _Curve.of(match >= 0, found.score, len(truths))
        ap_at_m[f"{distance_m:g}"] = curve.average_precision()
        if distance_m == ERROR_DISTANCE_M:
            errors = _errors(name, truths, found, match, curve)
    if name in _WITHOUT_HEADING:
        errors = NuscenesErrors(errors.ate, errors.ase, None, errors.aae)
    if name in _WITHOUT_ATTRIBUTES or not attributes_known or not (truths.attribute != "").any():
        errors = NuscenesErrors(errors.ate, errors.ase, errors.aoe, None)
    ap = float(np.mean(list(ap_at_m.values())))
    return NuscenesPrecision(len(truths), ap, {**ap_at_m}, errors)


def _near_pairs(truths: SweepTable, found: SweepTable) -> tuple[Indices, Indices, Floats]:
    """Predictions, truths and their distances (P,) below the largest that is asked for; predictions in their
    order, each with its nearest truth first."""
    parts: list[tuple[Indices, Indices, Floats]] = []
    for prediction, truth in sweep_pairs(found, truths):
        apart = found.boxes.center_cam[prediction] - truths.boxes.center_cam[truth]
        distance_m = np.hypot(apart[:, 0], apart[:, 2])
        near = distance_m < max(DISTANCES_M)
        parts.append((prediction[near], truth[near], distance_m[near]))
    predictions, nearest, distances_m = (
        np.concatenate([part[0] for part in parts]),
        np.concatenate([part[1] for part in parts]),
        np.concatenate([part[2] for part in parts]),
    )
    order = np.lexsort((nearest, distances_m, predictions))
    return predictions[order], nearest[order], distances_m[order]


def _matches(truth_count: int, sweep: Indices, prediction: Indices, truth: Indices) -> Indices:
    """(N,) the truth that each prediction takes, -1 for none; the better ones of a sweep choose first."""
    taken = np.zeros((truth_count, 1), dtype=np.bool_)
    chooser, choice = choose_in_turn(prediction, truth, sweep, taken)
    match = np.full(len(sweep), -1)
    match[chooser] = choice[:, 0]
    return match


@dataclass(frozen=True)
class _Curve:
    """Precision and score at recalls 0, 0.01, ..., 1; 0 beyond the last. hit_scores: of what is right."""

    precision: Floats
    score: Floats
    hit_scores: Floats

    @classmethod
    def of(cls, right: Mask, score: Floats, truth_count: int) -> _Curve:
        """right, score: (N,) of the predictions, best first."""
        if not right.any():
            return cls(np.zeros(len(_RECALLS)), np.zeros(len(_RECALLS)), np.empty(0))
        hits = np.cumsum(right).astype(np.float64)
        recall = hits / truth_count
        return cls(
            precision=np.interp(_RECALLS, recall, hits / np.arange(1, len(right) + 1), right=0),
            score=np.interp(_RECALLS, recall, score, right=0),
            hit_scores=score[right],
        )

    def average_precision(self) -> float:
        """Percent."""
        counted = (self.precision[_FIRST_RECALL:] - _MIN_PRECISION).clip(0)
        return 100 * float(counted.mean()) / (1 - _MIN_PRECISION)

    def mean_error(self, errors: Floats) -> float:
        """errors: of the predictions that are right, best first; NaN where there is none to tell."""
        reached = np.flatnonzero(self.score)
        if len(errors) == 0 or len(reached) == 0 or reached[-1] < _FIRST_RECALL:
            return 1.0
        so_far = _running_mean(errors)
        at_recalls = np.interp(self.score[::-1], self.hit_scores[::-1], so_far[::-1])[::-1]
        return float(at_recalls[_FIRST_RECALL : reached[-1] + 1].mean())


def _running_mean(values: Floats) -> Floats:
    """Mean of those so far that are no NaN; 0 where there are none yet, 1 everywhere where there are none."""
    known = ~np.isnan(values)
    if not known.any():
        return np.ones(len(values))
    counts = np.cumsum(known)
    mean: Floats = np.divide(np.nancumsum(values), counts, out=np.zeros(len(values)), where=counts > 0)
    return mean


def _errors(
    name: str, truths: SweepTable, found: SweepTable, match: Indices, curve: _Curve
) -> NuscenesErrors:
    right = match >= 0
    true, hit = truths.rows(match[right]), found.rows(right)
    apart = true.boxes.center_cam - hit.boxes.center_cam
    sizes, true_sizes = _sizes_m(hit.boxes), _sizes_m(true.boxes)
    shared = np.minimum(sizes, true_sizes).prod(axis=1)
    period = np.pi if name in _ALIKE_FROM_BEHIND else 2 * np.pi
    turned = wrap_angle((true.boxes.rotation_y - hit.boxes.rotation_y) * (2 * np.pi / period)) * (
        period / (2 * np.pi)
    )
    wrong = np.where(true.attribute == "", np.nan, (true.attribute != hit.attribute) * 1.0)
    return NuscenesErrors(
        ate=curve.mean_error(np.hypot(apart[:, 0], apart[:, 2])),
        ase=curve.mean_error(1 - shared / (sizes.prod(axis=1) + true_sizes.prod(axis=1) - shared)),
        aoe=curve.mean_error(np.abs(turned)),
        aae=curve.mean_error(wrong),
    )


def _as_not_found(name: str, result: NuscenesPrecision, attributes_known: bool) -> NuscenesPrecision:
    """What the benchmark makes of a class without truth."""
    if result.truths:
        return result
    heading = None if name in _WITHOUT_HEADING else 1.0
    attributes = None if name in _WITHOUT_ATTRIBUTES or not attributes_known else 1.0
    return NuscenesPrecision(0, 0.0, {}, NuscenesErrors(1.0, 1.0, heading, attributes))


def _means(results: Sequence[NuscenesPrecision]) -> NuscenesMeans:
    def mean(values: Iterable[float | None]) -> float | None:
        known = [value for value in values if value is not None]
        return float(np.mean(known)) if known else None

    return NuscenesMeans(
        classes=len(results),
        ap=mean(each.ap for each in results),
        errors=NuscenesErrors(*(mean(getattr(each.errors, field) for each in results) for field in _ERRORS)),
    )
