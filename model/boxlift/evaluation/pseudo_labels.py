"""How good labels are that were made from 2D prompts: found or not, and by how much off.

A truth is judged by the box of its own prompt. A prediction's 2D columns are its prompt's box, so truths
and predictions of a frame and class are associated one to one by their image boxes: largest IoU first,
at least 0.5. No score and no threshold is involved; a truth whose prompt got no box is missed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boxlift.boxes import wrap_angle
from boxlift.camera import Floats
from boxlift.evaluation.label_table import Indices, LabelTable, Mask, pairs_in_frames
from boxlift.evaluation.rules import DIFFICULTIES, HARD, rules_of
from boxlift.overlap import bev_iou, iou_2d, iou_3d

_MIN_PROMPT_IOU = 0.5
_RANGES_M = {"0-20 m": (0.0, 20.0), "20-40 m": (20.0, 40.0), "40+ m": (40.0, np.inf)}


@dataclass(frozen=True)
class AtIou:
    """Shares in [0, 1] at one IoU (a box is right above it); None where nothing is counted.

    recall: right boxes per truth. precision: right boxes per associated prediction.
    precision_of_all: right boxes per prediction, those without a truth included.
    """

    iou: float
    recall_bev: float | None
    recall_3d: float | None
    precision_bev: float | None
    precision_3d: float | None
    precision_of_all_bev: float | None
    precision_of_all_3d: float | None


@dataclass(frozen=True)
class PseudoLabelQuality:
    """One group of truths; means and medians are over the associated predictions, None without any.

    group: a difficulty (cumulative, as KITTI's) or a range: the hard truths by horizontal distance from
        the camera.
    truths, associated: counts. predictions: associated ones and those without a truth that are tall
        enough (their own 2D box) and within the range.
    at_iou: at the strict and the loose IoU of the class.
    center_error: between geometric centres. size_error: mean absolute (length, width, height);
    size_bias: mean of predicted minus true. yaw_error: median, as it is and with front and back alike.
    """

    group: str
    truths: int
    associated: int
    predictions: int
    at_iou: tuple[AtIou, ...]
    mean_iou_bev: float | None
    mean_iou_3d: float | None
    center_error_median_m: float | None
    center_error_mean_m: float | None
    size_error_lwh_m: tuple[float, float, float] | None
    size_bias_lwh_m: tuple[float, float, float] | None
    yaw_error_median_deg: float | None
    yaw_error_modulo_180_median_deg: float | None


def judge_pseudo_labels(
    truths: LabelTable, predictions: LabelTable, category: str
) -> tuple[PseudoLabelQuality, ...]:
    """Quality of one class: easy, moderate, hard, then near, middle and far.

    Lines with the format's placeholders in place of a 3D box do not count as boxes.
    Raises OptionsError for a class without rules.
    """
    rules = rules_of(category)
    truths = truths.rows(truths.is_any_of([category]) & truths.has_box3d)
    predictions = predictions.rows(predictions.is_any_of([category]) & predictions.has_box3d)
    pairs = _Associated.of(truths, predictions)
    extra = predictions.rows(~np.isin(np.arange(len(predictions)), pairs.prediction))
    truth_range_m, extra_range_m = _range_m(truths), _range_m(extra)
    groups: dict[str, tuple[Mask, Mask]] = {
        difficulty.name: (truths.counts_as(difficulty), extra.height_px >= difficulty.min_height_px)
        for difficulty in DIFFICULTIES
    }
    hard_truths, hard_extra = groups[HARD.name]
    for name, (low, high) in _RANGES_M.items():
        groups[name] = (
            hard_truths & (low <= truth_range_m) & (truth_range_m < high),
            hard_extra & (low <= extra_range_m) & (extra_range_m < high),
        )
    ious = (rules.strict_iou, rules.loose_iou)
    return tuple(
        _quality(name, pairs, in_group, int(extra_in_group.sum()), ious)
        for name, (in_group, extra_in_group) in groups.items()
    )


@dataclass(frozen=True)
class _Associated:
    """P pairs of a truth and the prediction of its prompt, and what lies between their boxes."""

    truth: Indices
    prediction: Indices
    iou_bev: Floats
    iou_3d: Floats
    center_error_m: Floats
    size_difference_lwh_m: Floats
    yaw_error_deg: Floats

    @classmethod
    def of(cls, truths: LabelTable, predictions: LabelTable) -> _Associated:
        truth, prediction = _associate(truths, predictions)
        true_boxes, boxes = truths.boxes[truth], predictions.boxes[prediction]
        sizes = [
            np.stack([some.length_m, some.width_m, some.height_m], axis=1) for some in (boxes, true_boxes)
        ]
        turned_rad = wrap_angle(boxes.rotation_y - true_boxes.rotation_y)
        return cls(
            truth,
            prediction,
            bev_iou(true_boxes, boxes),
            iou_3d(true_boxes, boxes),
            np.linalg.norm(boxes.center_cam - true_boxes.center_cam, axis=1),
            sizes[0] - sizes[1],
            np.abs(np.degrees(turned_rad)),
        )


def _associate(truths: LabelTable, predictions: LabelTable) -> tuple[Indices, Indices]:
    """One to one within frames, largest 2D IoU first (then the order of the files)."""
    rows, columns = pairs_in_frames(truths, predictions)
    iou = iou_2d(truths.box_px[rows], predictions.box_px[columns])
    best_first = np.argsort(-iou, kind="stable")
    best_first = best_first[iou[best_first] >= _MIN_PROMPT_IOU]
    partner_of_truth: dict[int, int] = {}
    used: set[int] = set()
    for truth, prediction in zip(rows[best_first].tolist(), columns[best_first].tolist(), strict=True):
        if truth not in partner_of_truth and prediction not in used:
            partner_of_truth[truth] = prediction
            used.add(prediction)
    in_order = sorted(partner_of_truth.items())
    truth_index, prediction_index = np.array(in_order, dtype=np.int64).reshape(-1, 2).T
    return truth_index, prediction_index


def _quality(
    group: str, pairs: _Associated, in_group: Mask, extra_count: int, ious: tuple[float, ...]
) -> PseudoLabelQuality:
    chosen = in_group[pairs.truth]
    truth_count, associated = int(in_group.sum()), int(chosen.sum())
    iou_bev, volume_iou = pairs.iou_bev[chosen], pairs.iou_3d[chosen]
    size_difference = pairs.size_difference_lwh_m[chosen]
    yaw_error = pairs.yaw_error_deg[chosen]

    def at(iou: float) -> AtIou:
        right_bev, right_3d = int((iou_bev > iou).sum()), int((volume_iou > iou).sum())
        of_all = associated + extra_count
        return AtIou(
            iou,
            recall_bev=_share(right_bev, truth_count),
            recall_3d=_share(right_3d, truth_count),
            precision_bev=_share(right_bev, associated),
            precision_3d=_share(right_3d, associated),
            precision_of_all_bev=_share(right_bev, of_all),
            precision_of_all_3d=_share(right_3d, of_all),
        )

    return PseudoLabelQuality(
        group,
        truth_count,
        associated,
        associated + extra_count,
        tuple(at(iou) for iou in ious),
        mean_iou_bev=_mean(iou_bev),
        mean_iou_3d=_mean(volume_iou),
        center_error_median_m=_median(pairs.center_error_m[chosen]),
        center_error_mean_m=_mean(pairs.center_error_m[chosen]),
        size_error_lwh_m=_mean_lwh(np.abs(size_difference)),
        size_bias_lwh_m=_mean_lwh(size_difference),
        yaw_error_median_deg=_median(yaw_error),
        yaw_error_modulo_180_median_deg=_median(np.minimum(yaw_error, 180 - yaw_error)),
    )


def _range_m(labels: LabelTable) -> Floats:
    center = labels.boxes.center_cam
    distance: Floats = np.hypot(center[:, 0], center[:, 2])
    return distance


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def _mean(values: Floats) -> float | None:
    return float(values.mean()) if len(values) else None


def _median(values: Floats) -> float | None:
    return float(np.median(values)) if len(values) else None


def _mean_lwh(values: Floats) -> tuple[float, float, float] | None:
    if len(values) == 0:
        return None
    length, width, height = values.mean(axis=0).tolist()
    return length, width, height
