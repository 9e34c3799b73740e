"""KITTI's average precision on cases that can be computed by hand."""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any

import numpy as np
import pytest

from boxlift.errors import OptionsError
from boxlift.evaluation import IouSet, KittiBenchmark, LabelTable
from boxlift.formats.kitti_label import KittiObject
from model.evaluation.labels_to_judge import FRAMES, Frames, car, dont_care, found, judge


def percent(*numbers: float) -> Any:
    return pytest.approx(numbers, abs=1e-9)


ALL, HALF, NONE = percent(100, 100, 100), percent(50, 50, 50), percent(0, 0, 0)
car_aside = partial(car, 12.0, 600.0)


def repeated(*objects: KittiObject) -> Frames:
    return [list(objects) for _ in range(FRAMES)]


@pytest.mark.parametrize("points", ["R11", "R40"])
def test_perfect_detections_reach_100(points: str) -> None:
    entry = judge(repeated(car()), repeated(found(car())), points=points)
    for curve in (entry.ap_2d, entry.ap_bev, entry.ap_3d, entry.aos):
        assert curve == ALL
    assert entry.truths == (FRAMES, FRAMES, FRAMES)


def test_class_names_are_compared_whatever_their_case() -> None:
    assert judge(repeated(car(category="car")), repeated(found(car(category="CAR")))).ap_3d == ALL


def test_a_tiny_curve_by_hand() -> None:
    # Four truths; by score: right (.9), wrong (.8), right (.7), right (.6); one truth is missed.
    # Precision at the three thresholds 1/1, 2/3, 3/4; the best at that recall or above: 1, 3/4, 3/4.
    truths = [[car()], [car()], [car()], [car()]]
    wrong = car_aside(score=0.8)
    detections = [[found(car(), 0.9), wrong], [found(car(), 0.7)], [found(car(), 0.6)], []]
    entry = judge(truths, detections)
    assert entry.ap_3d == pytest.approx([100 * (0.75 + 0.75) / 40] * 3)
    assert judge(truths, detections, points="R11").ap_3d == pytest.approx([100 / 11] * 3)


def test_half_of_the_truths_found() -> None:
    # 40 of 80: recalls 1/80, then 1/40, 2/40, ..., 20/40 are reached, all at precision 1.
    truths = [[car()] for _ in range(80)]
    detections: Frames = [[found(car(), 0.9 - 0.01 * i)] if i < 40 else [] for i in range(80)]
    assert judge(truths, detections).ap_2d == pytest.approx([100 * 20 / 40] * 3)
    assert judge(truths, detections, points="R11").ap_2d == pytest.approx([100 * 6 / 11] * 3)


def test_a_duplicate_of_the_same_score_is_false() -> None:
    nearly = dataclasses.replace(found(car()), box_px=(101.0, 200.0, 251.0, 300.0))
    entry = judge(repeated(car()), repeated(nearly, found(car())))
    assert entry.ap_2d == HALF
    assert entry.ap_3d == HALF


def test_a_duplicate_below_every_threshold_does_no_harm() -> None:
    assert judge(repeated(car()), repeated(found(car(), 0.9), found(car(), 0.1))).ap_2d == ALL


def test_of_two_detections_the_larger_overlap_gives_the_heading() -> None:
    flipped = dataclasses.replace(found(car(alpha=0.5 - np.pi)), box_px=(110.0, 200.0, 260.0, 300.0))
    # Half of the detections are duplicates; the truth takes the exact one, with the right heading.
    assert judge(repeated(car()), repeated(flipped, found(car()))).aos == HALF


def test_what_is_too_hard_may_be_found_or_missed() -> None:
    hidden = car_aside(occluded=3)
    assert judge(repeated(car(), hidden), repeated(found(car()))).ap_3d == ALL
    assert judge(repeated(car(), hidden), repeated(found(car()), found(hidden))).ap_3d == ALL


@pytest.mark.parametrize(
    ("truth", "truths"),
    [
        (car(), (1, 1, 1)),
        (car(occluded=1), (0, 1, 1)),
        (car(occluded=2), (0, 0, 1)),
        (car(occluded=3), (0, 0, 0)),
        (car(truncated=0.15), (1, 1, 1)),
        (car(truncated=0.16), (0, 1, 1)),
        (car(truncated=0.31), (0, 0, 1)),
        (car(truncated=0.51), (0, 0, 0)),
        (car(height_px=40), (0, 1, 1)),
        (car(height_px=25), (0, 0, 0)),
    ],
)
def test_difficulties(truth: KittiObject, truths: tuple[int, int, int]) -> None:
    assert judge([[truth]], [[]]).truths == truths


def test_without_a_truth_there_is_no_number() -> None:
    entry = judge(repeated(car(occluded=1)), repeated(found(car())))
    assert entry.ap_3d[0] is None
    assert entry.aos[0] is None
    assert entry.ap_3d[1:] == percent(100, 100)
    assert judge(repeated(car()), repeated(found(car())), category="Cyclist").ap_2d == (None, None, None)


def test_nothing_found_is_zero() -> None:
    entry = judge(repeated(car()), repeated())
    for curve in (entry.ap_2d, entry.ap_bev, entry.ap_3d, entry.aos):
        assert curve == NONE


def test_a_small_detection_is_neither_right_nor_wrong() -> None:
    small = found(car_aside(height_px=39))
    ap = judge(repeated(car()), repeated(found(car()), small)).ap_2d
    assert ap == percent(100, 50, 50)  # at easy, below 40 px, it is forgiven
    # A truth of 41 px that only a detection of 39 px finds is out of the count at easy.
    ap = judge(repeated(car(height_px=41)), repeated(found(car(height_px=39)))).ap_2d
    assert ap == percent(0, 100, 100)


def test_dont_care_forgives_in_the_image_only() -> None:
    false = found(car_aside())
    without = judge(repeated(car()), repeated(found(car()), false))
    for curve in (without.ap_2d, without.ap_bev, without.ap_3d):
        assert curve == HALF
    within = judge(repeated(car(), dont_care(550.0)), repeated(found(car()), false))
    assert within.ap_2d == ALL
    assert within.ap_bev == HALF
    assert within.ap_3d == HALF


def test_a_neighbouring_class_does_neither_good_nor_harm() -> None:
    van, truck = car_aside(category="Van"), car_aside(category="Truck")
    as_car = found(car_aside())
    assert judge(repeated(car(), van), repeated(found(car()))).ap_3d == ALL
    assert judge(repeated(car(), van), repeated(found(car()), as_car)).ap_3d == ALL
    assert judge(repeated(car(), truck), repeated(found(car()), as_car)).ap_3d == HALF
    # The detection of another class is nothing to a car.
    assert judge(repeated(car(), van), repeated(found(car()), found(van))).ap_3d == ALL


@pytest.mark.parametrize(("turn", "aos"), [(0, 100), (np.pi / 2, 50), (np.pi, 0), (-np.pi, 0)])
def test_orientation_similarity(turn: float, aos: float) -> None:
    entry = judge(repeated(car(alpha=0.5)), repeated(found(car(alpha=0.5 + turn))))
    assert entry.ap_2d == ALL
    assert entry.aos == percent(aos, aos, aos)


def test_no_orientation_similarity_without_headings() -> None:
    entry = judge(repeated(car()), repeated(dataclasses.replace(found(car()), alpha=-10.0)))
    assert entry.ap_2d == ALL
    assert entry.aos == (None, None, None)


def test_an_iou_at_the_limit_is_not_enough() -> None:
    # 1 m beside: 4 - 1 over 4 + 1 of the length is an IoU of 3/5, from above and in 3D.
    truth, moved = car(alpha=0.0), dataclasses.replace(found(car()), bottom_center_cam=(1.0, 1.7, 20.0))
    moved = dataclasses.replace(moved, rotation_y=0.0)
    benchmark = KittiBenchmark(
        LabelTable.from_frames(repeated(truth)), LabelTable.from_frames(repeated(moved))
    )
    sets = [IouSet(0.99, 0.61, 0.61), IouSet(0.99, 0.59, 0.59), IouSet(1.0, 0.1, 0.1)]
    r40 = [entry for entry in benchmark.average_precision("Car", sets) if entry.recall_points == "R40"]
    assert [entry.ap_bev for entry in r40] == [NONE, ALL, ALL]
    assert [entry.ap_3d for entry in r40] == [NONE, ALL, ALL]
    assert [entry.ap_2d for entry in r40] == [ALL, ALL, NONE]
    assert [entry.iou_3d for entry in r40] == [0.61, 0.59, 0.1]


def test_a_class_without_rules_needs_ious() -> None:
    tram = car(category="Tram")
    benchmark = KittiBenchmark(
        LabelTable.from_frames(repeated(tram)), LabelTable.from_frames(repeated(found(tram)))
    )
    with pytest.raises(OptionsError, match="'Tram' has no rules"):
        benchmark.average_precision("Tram")
    assert benchmark.average_precision("Tram", [IouSet(0.5, 0.5, 0.5)])[1].ap_3d == ALL
