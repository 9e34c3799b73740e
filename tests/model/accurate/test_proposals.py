from __future__ import annotations

import numpy as np
import pytest

from boxlift.accurate.parameters import BOTTOM, HEIGHT, LENGTH, YAW, X, Z
from boxlift.accurate.polish import outline_distance
from boxlift.accurate.proposals import distinct, find_clusters, lower_half, main_directions, propose
from boxlift.accurate.view import Region, View, region_of
from boxlift.camera import Floats
from boxlift.settings import RepairSettings
from model.accurate.by_hand import (
    LWH_M,
    a_box,
    outline_points,
    prompt_of,
    unclaimed,
    upright,
    view_of,
)
from model.small_frame import CAMERA_HEIGHT_M

REPAIRS = RepairSettings()
QUARTER = np.pi / 2


def seen(points_cam: Floats, box: Floats) -> tuple[View, Region]:
    """The view of some points, and what the exact prompt of a box (1, 7) is about."""
    view = view_of(points_cam, [prompt_of(box)])
    return view, region_of(view, 0, unclaimed(view), 1.7)


def proposed(points_cam: Floats, box: Floats, repairs: RepairSettings = REPAIRS) -> Floats:
    view, region = seen(points_cam, box)
    return propose(view, region, find_clusters(view, region, repairs), LWH_M, 100, repairs)


def turn_between(yaw: float, other: float) -> float:
    """Between directions that are alike after a quarter turn, radians."""
    return abs((yaw - other + QUARTER / 2) % QUARTER - QUARTER / 2)


def nearest(boxes: Floats, truth: Floats) -> tuple[float, float]:
    """Distance in metres, and turn in radians modulo a half turn, of the proposal closest to a box."""
    away = np.hypot(*(boxes - truth)[:, [X, Z]].T)
    turn = np.abs((boxes[:, YAW] - truth[0, YAW] + QUARTER) % np.pi - QUARTER)
    best = int((away + turn).argmin())
    return float(away[best]), float(turn[best])


def test_a_wall_that_goes_on_outside_is_less_likely_than_the_object() -> None:
    car = a_box(1.0, 15.0, -QUARTER)
    wall = upright(np.stack([np.linspace(-12, 12, 241), np.full(241, 22.0)], axis=1))
    points = np.concatenate([upright(outline_points(car)), wall])
    view, region = seen(points, car)
    first, *others = find_clusters(view, region, REPAIRS)
    assert (view.points_cam[first.rows][:, 2] < 20).all()
    assert any((view.points_cam[cluster.rows][:, 2] > 20).all() for cluster in others)
    assert first.likeness > 1.5 * max(cluster.likeness for cluster in others)


def test_two_cars_that_touch_are_parted_at_the_finer_scale() -> None:
    """0.3 m from bumper to bumper, along the road: the rear of the farther one is in the prompt too."""
    car, behind_it = a_box(-3.0, 8.0, -QUARTER), a_box(-3.0, 12.3, -QUARTER)
    both = np.concatenate([outline_points(box, 40) for box in (car, behind_it)])
    view, region = seen(upright(both), car)
    (joined,) = find_clusters(view, region, RepairSettings(cluster_scales=(1.0,)))
    parted = find_clusters(view, region, REPAIRS)
    assert view.points_cam[joined.rows][:, 2].max() > 10.2
    assert view.points_cam[parted[0].rows][:, 2].max() < 10.1
    assert joined.rows.tolist() in [cluster.rows.tolist() for cluster in parted]


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_points_make_no_cluster_and_the_prompt_remains(count: int) -> None:
    car = a_box()
    points = upright(outline_points(car), [0.7])[:count]
    view, region = seen(points, car)
    assert find_clusters(view, region, REPAIRS) == []
    assert len(proposed(points, car)) == 2
    assert proposed(points, car, RepairSettings(prompt_placement=False)).shape == (0, 7)


def test_no_more_clusters_than_asked_for() -> None:
    car = a_box(0.0, 10.0, 0.0)
    posts = np.stack([np.linspace(-1.8, 1.8, 5), np.full(5, 9.2)], axis=1).repeat(4, axis=0)
    view, region = seen(upright(posts), car)
    assert len(find_clusters(view, region, RepairSettings(max_clusters=20))) == 5
    assert len(find_clusters(view, region, RepairSettings(max_clusters=2))) == 2


def test_of_many_points_the_lower_half_remains() -> None:
    view, region = seen(upright(outline_points(a_box()), (0.4, 0.8, 1.2)), a_box())
    assert len(lower_half(view, region.inside)) < len(region.inside)
    low = view.above_m[region.inside] < 1.0
    assert len(lower_half(view, region.inside)) == low.sum()
    assert len(lower_half(view, region.inside[:9])) == 9


@pytest.mark.parametrize("yaw", [-1.5, -1.2, -0.8, -0.3, 0.1, 0.6])
def test_headings_of_an_l_shape_and_of_a_single_face(yaw: float) -> None:
    points_xz = outline_points(a_box(2.0, 15.0, yaw))
    for shape in (points_xz, points_xz[:20], points_xz[20:]):
        directions = main_directions(shape, closeness=True)
        assert min(turn_between(direction, yaw) for direction in directions) < 0.05
        assert len(main_directions(shape, closeness=False)) == 1


def test_a_round_corner_misleads_the_pairs_but_not_the_l_shape() -> None:
    """Points all along a rear with round corners, and few on the side."""
    yaw = 0.5
    along, across = np.array([np.cos(yaw), -np.sin(yaw)]), np.array([np.sin(yaw), np.cos(yaw)])
    side = np.linspace(0.0, 4.0, 12)[:, None] * along
    end = np.linspace(0.0, 1.7, 12)[:, None] * across
    oblique = np.array([0.0, 14.0]) + np.linspace(0.0, 1.3, 30)[:, None] * (along + across) / np.sqrt(2)
    points_xz = np.concatenate([np.array([0.0, 14.0]) + side, np.array([0.0, 14.0]) + end, oblique])
    mode, *shapes = main_directions(points_xz, closeness=True)
    assert turn_between(mode, yaw) > 0.5
    assert [turn_between(shape, yaw) < 0.05 for shape in shapes] == [True]


def test_points_in_one_place_still_have_a_direction() -> None:
    for count in (1, 2, 30):
        directions = main_directions(np.tile([[1.0, 9.0]], (count, 1)), closeness=True)
        assert np.isfinite(directions).all()


def test_a_box_touches_an_l_shape_with_its_near_sides() -> None:
    car = a_box(3.0, 15.0, -1.0)
    away, turn = nearest(proposed(upright(outline_points(car)), car), car)
    assert away < 0.15
    assert turn < 0.05


def test_a_rear_alone_is_tried_as_rear_and_as_side() -> None:
    """The one face that is seen is 1.7 m wide: the box behind it, lengthwise and crosswise."""
    car = a_box(0.0, 15.0, -QUARTER)
    rear = upright(outline_points(car)[:20])
    only_clusters = RepairSettings(prompt_placement=False)
    boxes = proposed(rear, car, only_clusters)
    away, turn = nearest(boxes, car)
    assert away < 0.15
    assert turn < 0.05
    assert turn_between(float(boxes[:, YAW].max() - boxes[:, YAW].min()), 0.0) < 0.05
    assert np.ptp(boxes[:, YAW]) == pytest.approx(QUARTER, abs=0.05)
    assert (
        np.ptp(proposed(rear, car, RepairSettings(prompt_placement=False, perpendicular=False))[:, YAW]) == 0
    )
    # Nothing stands before the face that was seen.
    assert (outline_distance(boxes, np.array([[0.0, 12.0]])) > 0).all()


def test_what_the_border_cuts_may_lie_at_either_end_of_its_points() -> None:
    """Of a car along x half is seen: what is missing may be to its left or, hidden, to its right."""
    car = a_box(-9.0, 10.0, 0.0)
    points_xz = outline_points(car)
    view, region = seen(upright(points_xz[points_xz[:, 0] > -8.9]), car)
    assert region.cut[0]
    boxes = propose(
        view,
        region,
        find_clusters(view, region, REPAIRS),
        LWH_M,
        100,
        RepairSettings(prompt_placement=False, perpendicular=False),
    )
    lengthwise = boxes[np.abs(np.cos(boxes[:, YAW])) > 0.9]
    away, turn = nearest(boxes, car)
    assert away < 0.25
    assert turn < 0.05
    assert np.ptp(lengthwise[:, X]) > 1.0


def test_the_prompt_alone_places_boxes_that_fill_it() -> None:
    car = a_box(2.0, 20.0, -QUARTER)
    boxes = proposed(np.empty((0, 3)), car)
    assert boxes[:, Z] == pytest.approx(20.0, abs=1.5)
    assert boxes[:, X] == pytest.approx(2.0, abs=0.3)
    assert boxes[:, LENGTH : HEIGHT + 1].tolist() == [LWH_M.tolist()] * 2


def test_proposals_stand_on_the_ground_and_differ() -> None:
    boxes = proposed(upright(outline_points(a_box())), a_box())
    assert boxes[:, BOTTOM].tolist() == [CAMERA_HEIGHT_M] * len(boxes)
    assert len(distinct(boxes)) == len(boxes)


def test_of_rows_that_are_alike_the_first_remains() -> None:
    rows = np.array([[1.1, 9.0, 0.5, 7.0], [4.0, 9.0, 0.5, 8.0], [1.15, 9.0, 0.5, 9.0]])
    assert distinct(rows).tolist() == rows[:2].tolist()
    assert distinct(np.empty((0, 7))).shape == (0, 7)
