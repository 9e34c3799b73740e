"""The quality of labels made from prompts, on cases that can be counted."""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any

import numpy as np
import pytest

from boxlift.errors import OptionsError
from boxlift.evaluation import LabelTable, PseudoLabelQuality, judge_pseudo_labels
from boxlift.formats.kitti_label import KittiObject
from model.evaluation.labels_to_judge import Frames, car, found

car_aside = partial(car, 12.0, 600.0)


def quality(truths: Frames, predictions: Frames, category: str = "Car") -> dict[str, PseudoLabelQuality]:
    groups = judge_pseudo_labels(
        LabelTable.from_frames(truths), LabelTable.from_frames(predictions), category
    )
    return {group.group: group for group in groups}


def label(truth: KittiObject, **changes: Any) -> KittiObject:
    """What a labeller says for the prompt of a truth."""
    return dataclasses.replace(found(truth), **changes)


def test_perfect_labels() -> None:
    truths = [[car(), car_aside()], [car()]]
    easy = quality(truths, [[label(truth) for truth in frame] for frame in truths])["easy"]
    assert (easy.truths, easy.associated, easy.predictions) == (3, 3, 3)
    for at in easy.at_iou:
        assert (at.recall_bev, at.recall_3d, at.precision_3d, at.precision_of_all_3d) == (1, 1, 1, 1)
    assert easy.mean_iou_3d == pytest.approx(1)
    assert easy.center_error_mean_m == 0
    assert easy.yaw_error_median_deg == 0
    assert easy.size_error_lwh_m == (0, 0, 0)


def test_a_truth_is_judged_by_its_own_prompt_and_by_no_other() -> None:
    # The two prompts' boxes are swapped in 3D: each place has a box, but neither is its own prompt's.
    left, right = car(), car_aside()
    swapped = [
        label(left, bottom_center_cam=right.bottom_center_cam),
        label(right, bottom_center_cam=left.bottom_center_cam),
    ]
    easy = quality([[left, right]], [swapped])["easy"]
    assert easy.associated == 2
    assert easy.at_iou[1].recall_bev == 0
    assert easy.center_error_median_m == pytest.approx(12)


def test_a_truth_without_a_label_is_missed_and_an_invented_label_costs_precision() -> None:
    invented = label(car_aside())
    easy = quality([[car()], [car()]], [[label(car()), invented], []])["easy"]
    assert (easy.truths, easy.associated, easy.predictions) == (2, 1, 2)
    strict = easy.at_iou[0]
    assert (strict.recall_3d, strict.precision_3d, strict.precision_of_all_3d) == (0.5, 1, 0.5)


def test_recall_and_precision_at_both_ious() -> None:
    # Along the length of 4 m: 0.4 m off is an IoU of 9/11 = .82, 1 m .60, 2 m .33, and .33 is too little.
    truth = car(alpha=0.0)
    shifts_m = (0.4, 1.0, 2.0)
    labels = [[label(truth, bottom_center_cam=(shift, 1.7, 20.0))] for shift in shifts_m]
    easy = quality([[truth]] * 3, labels)["easy"]
    assert [at.iou for at in easy.at_iou] == [0.7, 0.5]
    assert [at.recall_bev for at in easy.at_iou] == pytest.approx([1 / 3, 2 / 3])
    assert [at.precision_3d for at in easy.at_iou] == pytest.approx([1 / 3, 2 / 3])
    assert easy.mean_iou_bev == pytest.approx((3.6 / 4.4 + 3 / 5 + 2 / 6) / 3)
    assert easy.center_error_median_m == pytest.approx(1)
    assert easy.center_error_mean_m == pytest.approx(3.4 / 3)


def test_size_errors_are_length_width_height() -> None:
    longer, wider = label(car(), size_hwl_m=(1.5, 1.6, 4.4)), label(car(), size_hwl_m=(1.3, 1.7, 3.8))
    easy = quality([[car()], [car()]], [[longer], [wider]])["easy"]
    assert easy.size_error_lwh_m == pytest.approx((0.3, 0.05, 0.1))
    assert easy.size_bias_lwh_m == pytest.approx((0.1, 0.05, -0.1))
    # The bottoms agree: half of 20 cm less height is what the centre is off.
    assert easy.center_error_mean_m == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("turn_deg", "full", "modulo"),
    [(10, 10, 10), (-10, 10, 10), (170, 170, 10), (190, 170, 10), (90, 90, 90)],
)
def test_yaw_error_with_and_without_front_and_back(turn_deg: float, full: float, modulo: float) -> None:
    truth = car(alpha=3.0)
    turned = label(truth, rotation_y=truth.rotation_y + np.radians(turn_deg))
    easy = quality([[truth]], [[turned]])["easy"]
    assert easy.yaw_error_median_deg == pytest.approx(full)
    assert easy.yaw_error_modulo_180_median_deg == pytest.approx(modulo)


def test_prompts_are_associated_one_to_one_by_the_largest_overlap() -> None:
    # Two truths of overlapping prompts, labels in the other order; the image boxes tell them apart.
    near, far = (
        car(left_px=100.0),
        dataclasses.replace(car(left_px=130.0), bottom_center_cam=(0.0, 1.7, 30.0)),
    )
    easy = quality([[near, far]], [[label(far), label(near)]])["easy"]
    assert easy.center_error_mean_m == 0
    # One label for both: only the truth of its own prompt has it.
    easy = quality([[near, far]], [[label(far)]])["easy"]
    assert (easy.truths, easy.associated, easy.center_error_mean_m) == (2, 1, 0)


def test_prompts_that_overlap_less_than_half_are_not_the_same() -> None:
    # 150 px wide: 50 px beside is an IoU of .5, 51 px is less.
    assert quality([[car()]], [[label(car(left_px=150.0))]])["easy"].associated == 1
    assert quality([[car()]], [[label(car(left_px=151.0))]])["easy"].associated == 0


def test_other_frames_and_classes_do_not_meet() -> None:
    assert quality([[car()], []], [[], [label(car())]])["easy"].associated == 0
    van = label(car(), category="Van")
    assert quality([[car()]], [[van]])["easy"].associated == 0
    assert quality([[car(category="Van")]], [[van]], "Van")["easy"].associated == 1


def test_a_line_without_a_3d_box_is_no_label() -> None:
    unlabelled = label(car(), size_hwl_m=(-1.0, -1.0, -1.0), bottom_center_cam=(-1000.0, -1000.0, -1000.0))
    easy = quality([[car()]], [[unlabelled]])["easy"]
    assert (easy.truths, easy.predictions, easy.at_iou[1].recall_3d) == (1, 0, 0)


def test_groups_by_difficulty_and_range() -> None:
    def at(distance_m: float, occluded: int) -> KittiObject:
        return dataclasses.replace(car(occluded=occluded), bottom_center_cam=(0.0, 1.7, distance_m))

    truths = [[at(19.9, 0)], [at(20.0, 1)], [at(39.9, 2)], [at(40.0, 0)], [at(70.0, 3)]]
    groups = quality(truths, [[label(frame[0])] for frame in truths])
    counts = {name: (group.truths, group.associated) for name, group in groups.items()}
    assert counts == {
        "easy": (2, 2),
        "moderate": (3, 3),
        "hard": (4, 4),
        "0-20 m": (1, 1),
        "20-40 m": (2, 2),
        "40+ m": (1, 1),
    }


def test_invented_labels_are_counted_where_they_could_be_seen() -> None:
    small = label(car(height_px=30.0))
    groups = quality([[]], [[small]])
    assert {name: group.predictions for name, group in groups.items()} == {
        "easy": 0,
        "moderate": 1,
        "hard": 1,
        "0-20 m": 0,
        "20-40 m": 1,
        "40+ m": 0,
    }
    assert groups["hard"].at_iou[0].recall_3d is None
    assert groups["hard"].at_iou[0].precision_3d is None
    assert groups["hard"].at_iou[0].precision_of_all_3d == 0
    assert groups["hard"].mean_iou_3d is None


def test_a_class_without_rules() -> None:
    with pytest.raises(OptionsError, match="'Tram' has no rules"):
        quality([[]], [[]], "Tram")
