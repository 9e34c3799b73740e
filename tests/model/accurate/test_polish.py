from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from boxlift.accurate.parameters import BOTTOM, HEIGHT, LENGTH, WIDTH, YAW, X, Z, project_edges
from boxlift.accurate.polish import (
    SizePull,
    Target,
    Viewpoint,
    _linearised,
    edge_errors,
    outline_distance,
    point_weights,
    polish,
)
from boxlift.camera import Floats
from model.accurate.by_hand import LWH_M, a_box, outline_points, prompt_of
from model.small_frame import CALIBRATION, CAMERA_HEIGHT_M, IMAGE_SIZE_PX

VIEWPOINT = Viewpoint(CALIBRATION.image_P_cam, IMAGE_SIZE_PX)
SIZE = SizePull(LWH_M, 0.1 * LWH_M)
TRUTH = a_box()
OFF = np.array([0.25, -0.3, 0.12, 0.0, 0.0, 0.0, 0.1])


def target_of(truth: Floats, count: int = 1, per_side: int = 20, size: SizePull = SIZE) -> Target:
    """What `count` hypotheses on a box (1, 7) are pulled to, seen without error."""
    points_xz = outline_points(truth, per_side)
    weights = point_weights(points_xz, 0.4)
    ground_y = np.full(count, CAMERA_HEIGHT_M)
    known = np.ones(count, dtype=np.bool_)
    return Target.of_one(points_xz, weights, np.array(prompt_of(truth).box_px), size, ground_y, known)


def cost(boxes: Floats, start: Floats, target: Target, viewpoint: Viewpoint = VIEWPOINT) -> Floats:
    return _linearised(boxes, start[:, YAW], target, [viewpoint])[0]


def scattered(count: int) -> Floats:
    rng = np.random.default_rng(0)
    spread = np.array([1.0, 1.5, 0.6, 0.5, 0.3, 0.2, 0.2])
    boxes: Floats = TRUTH + rng.uniform(-1, 1, (count, 7)) * spread
    return boxes


def test_outline_distance_is_signed() -> None:
    box = a_box(0.0, 10.0, 0.0)
    points_xz = np.array([[0.0, 10.0], [2.0, 10.0], [2.5, 10.0], [0.0, 11.0]])
    assert outline_distance(box, points_xz)[0].tolist() == pytest.approx([-0.85, 0.0, 0.5, 0.15])


def test_a_crowd_of_points_weighs_as_much_as_one_alone() -> None:
    weights = point_weights(np.array([[0.0, 9.0]] * 5 + [[3.0, 9.0]]), 0.4)
    assert weights[:5].sum() == pytest.approx(weights[5])
    assert weights.sum() == pytest.approx(6)


def test_many_points_are_worth_ten() -> None:
    assert point_weights(np.random.default_rng(0).uniform(0, 4, (80, 2)), 0.4).sum() == pytest.approx(10)
    assert point_weights(np.empty((0, 2)), 0.4).shape == (0,)


def test_the_gradient_is_half_the_slope_of_the_cost() -> None:
    boxes = scattered(30)
    target = target_of(TRUTH, len(boxes))
    start = boxes + 0.1  # so that the pull on the heading counts
    _, _, gradient = _linearised(boxes, start[:, YAW], target, [VIEWPOINT])
    step = 1e-6
    for column in range(7):
        aside = step * np.eye(7)[column]
        slope = (cost(boxes + aside, start, target) - cost(boxes - aside, start, target)) / (2 * step)
        assert gradient[:, column] == pytest.approx(slope / 2, rel=1e-4, abs=1e-4)


def test_finds_back_a_box_that_was_shifted_and_turned() -> None:
    (found,), _ = polish(TRUTH + OFF, target_of(TRUTH), [VIEWPOINT], 20)
    assert found[[X, Z, BOTTOM]].tolist() == pytest.approx(TRUTH[0, [X, Z, BOTTOM]].tolist(), abs=0.03)
    assert found[YAW] == pytest.approx(TRUTH[0, YAW], abs=0.02)
    assert found[LENGTH : HEIGHT + 1].tolist() == pytest.approx(LWH_M.tolist(), abs=0.05)


def test_finds_a_size_that_is_not_the_typical_one() -> None:
    longer = TRUTH.copy()
    longer[:, LENGTH : HEIGHT + 1] *= (1.12, 1.06, 1.1)
    (found,), _ = polish(TRUTH, target_of(longer), [VIEWPOINT], 20)
    before, after = (np.abs(box - longer[0])[LENGTH : HEIGHT + 1] for box in (TRUTH[0], found))
    assert (after < 0.5 * before).all()


def test_no_step_raises_the_cost() -> None:
    boxes = scattered(30)
    target = target_of(TRUTH, len(boxes))
    costs = [cost(polish(boxes, target, [VIEWPOINT], steps)[0], boxes, target) for steps in range(10)]
    assert (np.diff(costs, axis=0) <= 0).all()
    assert (costs[-1] < costs[0]).all()


def test_without_steps_nothing_moves_and_the_start_is_never_written_to() -> None:
    start = TRUTH + OFF
    kept = start.copy()
    assert polish(start, target_of(TRUTH), [VIEWPOINT], 0)[0].tolist() == kept.tolist()
    polish(start, target_of(TRUTH), [VIEWPOINT], 5)
    assert start.tolist() == kept.tolist()


def test_without_points_and_edges_size_and_bottom_are_what_was_expected() -> None:
    start = TRUTH + np.array([0, 0, 0, 0.4, -0.2, 0.3, 0.2])
    target = replace(target_of(TRUTH), weights=np.zeros((1, 40)))
    (found,), _ = polish(start, target, [replace(VIEWPOINT, weight=0)], 20)
    assert found.tolist() == pytest.approx(TRUTH[0].tolist(), abs=1e-3)


def test_a_point_far_away_hardly_matters() -> None:
    start, target = TRUTH + OFF, target_of(TRUTH)
    stray = replace(
        target,
        points_xz=np.concatenate([target.points_xz, [[[7.0, 21.0]]]], axis=1),
        weights=np.concatenate([target.weights, [[0.25]]], axis=1),
    )
    without, with_it = (polish(start, one, [VIEWPOINT], 20)[0][0] for one in (target, stray))
    assert with_it.tolist() == pytest.approx(without.tolist(), abs=0.02)


def test_an_edge_beyond_the_border_costs_nothing() -> None:
    """Two cars reach out of the image on the left, one of them farther: the image shows them alike."""
    for x in (-9.5, -10.5):
        box = a_box(x, 10.0, 0.0)
        edges, _ = project_edges(box, CALIBRATION.image_P_cam)
        assert edges[0, 0] < 0 < edges[0, 2]
        prompt_px = np.clip(edges, 0, None)
        errors, slopes = edge_errors(box, prompt_px, IMAGE_SIZE_PX, CALIBRATION.image_P_cam)
        assert errors.tolist() == [[0, 0, 0, 0]]
        assert not slopes[0, 0].any()
        assert slopes[0, 2].any()


def test_an_edge_within_the_image_costs_by_its_distance() -> None:
    edges, _ = project_edges(TRUTH, CALIBRATION.image_P_cam)
    errors, _ = edge_errors(TRUTH, edges - np.array([10.0, 0, 0, 0]), IMAGE_SIZE_PX, CALIBRATION.image_P_cam)
    assert errors[0, 0] > 2
    assert errors[0, 1:].tolist() == [0, 0, 0]


def test_together_boxes_end_where_each_ends_alone() -> None:
    """Padding to a common number of points, and other boxes, change nothing."""
    truths = [a_box(), a_box(-4.0, 22.0, 0.3), a_box(5.0, 9.0, -1.6)]
    targets = [target_of(one, 2, per_side) for one, per_side in zip(truths, (5, 20, 11), strict=True)]
    starts = [np.repeat(one, 2, axis=0) + OFF * np.array([[1], [-1]]) for one in truths]
    alone = [polish(start, one, [VIEWPOINT], 8)[0] for start, one in zip(starts, targets, strict=True)]
    together, _ = polish(np.concatenate(starts), Target.joined(targets), [VIEWPOINT], 8)
    assert together == pytest.approx(np.concatenate(alone), abs=1e-6)


@pytest.mark.parametrize("column", [LENGTH, WIDTH, HEIGHT])
def test_no_side_becomes_negative(column: int) -> None:
    size = SizePull(np.full(3, 0.1), np.full(3, 0.01))
    found, _ = polish(TRUTH, target_of(TRUTH, size=size), [VIEWPOINT], 30)
    assert found[0, column] > 0
