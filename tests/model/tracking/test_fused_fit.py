"""One box from what many frames saw: seen from two sides, and no neighbour's points."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from boxlift.accurate.parameters import HEIGHT, LENGTH, WIDTH, YAW, X, Z, project_edges, to_boxes
from boxlift.accurate.pipeline import size_pull
from boxlift.accurate.view import View
from boxlift.camera import Floats
from boxlift.datasets.generated import KITTI_RIG
from boxlift.fit import FitProblem, fit_boxes
from boxlift.frame import Frame, Prompt
from boxlift.ground import Ground, GroundPlane
from boxlift.losses import BevBoxes, balanced_loss, ray_tracing
from boxlift.poses import about_z, inverse, pose
from boxlift.settings import ACCURATE, PAPER
from boxlift.tracking.fused_fit import fit_fused, transformed
from boxlift.tracking.glimpses import Glimpse
from boxlift.tracking.paths import Motion, Path

CAR = np.array([0.0, 0.0, 0.0, 3.6, 1.65, 1.5, 0.0])
WORLD_SE3_OBJECT = pose(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), np.array([30.0, 4.0, 0.0]))
PATH = Path(Motion.STATIC, 0, 1, WORLD_SE3_OBJECT[None, :3, 3], WORLD_SE3_OBJECT[None, :3, :3], False)


def points_of(side: str, count: int = 60) -> Floats:
    """Points on one side of the car, in its frame."""
    rng = np.random.default_rng(0)
    along, up = rng.uniform(-1, 1, count), -rng.uniform(0.3, 1.1, count)
    half_length, half_width = CAR[LENGTH] / 2, CAR[WIDTH] / 2
    if side == "back":
        return np.column_stack([np.full(count, -half_length), up, along * half_width])
    return np.column_stack([along * half_length, up, np.full(count, half_width)])


def glimpse(number: int, camera_at: tuple[float, float], points: Floats) -> Glimpse:
    """A frame whose camera stands at x, y in the world and looks at the car, with points of its frame."""
    away = WORLD_SE3_OBJECT[:2, 3] - camera_at
    looks = about_z(float(np.arctan2(away[1], away[0])))
    axes = looks @ np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    world_SE3_cam = pose(axes, np.array([*camera_at, 1.65]))
    calibration = KITTI_RIG.calibration
    cam_SE3_object = np.linalg.inv(world_SE3_cam) @ WORLD_SE3_OBJECT
    points_cam = points @ cam_SE3_object[:3, :3].T + cam_SE3_object[:3, 3]
    outline = project_edges(transformed(CAR[None], cam_SE3_object), calibration.image_P_cam)[0][0]
    box_px = (float(outline[0]), float(outline[1]), float(outline[2]), float(outline[3]))
    frame = Frame(
        f"{number}", np.zeros((0, 3)), calibration, KITTI_RIG.image_size_px, (Prompt("Car", box_px),)
    )
    pixels, _ = calibration.project(points_cam)
    ground = Ground(np.zeros(0, dtype=np.bool_), GroundPlane(np.array([0.0, -1, 0]), 1.65))
    view = View(frame, ground, points_cam, pixels, ground.height_above(points_cam))
    own = transformed(CAR[None], cam_SE3_object)[0]
    return Glimpse.of(view, 0, number, world_SE3_cam, 1.5, own)


def fitted(glimpses: list[Glimpse], boxes: Floats) -> Floats:
    size = size_pull(ACCURATE.sizes["Car"])
    return fit_fused(glimpses, PATH, boxes, np.full(len(boxes), 0.9), size, ACCURATE).parameters


def test_two_sides_seen_by_two_frames_give_a_size_that_neither_knew() -> None:
    frames = [glimpse(0, (5.0, 4.0), points_of("back")), glimpse(1, (29.0, 24.0), points_of("side"))]
    starts = np.array(
        [CAR + np.array([0.5, 0.3, 0.05, 0.5, 0.1, 0, 0]), CAR + np.array([-0.4, 0, 0, 0.4, 0, 0, 0])]
    )
    found = fitted(frames, starts)
    assert np.abs(found[[X, Z]]).max() < 0.12
    assert found[LENGTH] == pytest.approx(CAR[LENGTH], abs=0.2)
    assert found[WIDTH] == pytest.approx(CAR[WIDTH], abs=0.12)
    assert found[HEIGHT] == pytest.approx(CAR[HEIGHT], abs=0.08)
    assert abs(found[YAW]) < 0.03


def test_the_car_behind_is_another_things_points() -> None:
    """As in a row of parked cars: a gap of .8 m, and its bumper within reach of a box that is too long."""
    rng = np.random.default_rng(1)
    behind = np.column_stack(
        [CAR[LENGTH] / 2 + 0.8 + rng.uniform(0, 4, 80), -rng.uniform(0.3, 1, 80), np.full(80, CAR[WIDTH] / 2)]
    )
    frames = [
        glimpse(0, (5.0, 5.0), points_of("back")),
        glimpse(1, (10.0, 18.0), np.concatenate([points_of("side"), behind])),
    ]
    too_long = CAR + np.array([0.45, 0, 0, 0.9, 0, 0, 0])
    found = fitted(frames, np.array([too_long]))
    assert found[LENGTH] == pytest.approx(CAR[LENGTH], abs=0.3)
    assert abs(found[X]) < 0.2


def test_too_few_points_leave_what_most_frames_say() -> None:
    few = glimpse(0, (5.0, 4.0), points_of("back", 2))
    boxes = np.array([CAR, CAR + 0.1, CAR - 0.1])
    size = size_pull(ACCURATE.sizes["Car"])
    found = fit_fused([few], PATH, boxes, np.full(3, 0.9), size, ACCURATE)
    assert found.losses is None
    assert found.cost == np.inf
    assert np.allclose(found.parameters[[X, Z]], 0)


def test_a_glimpse_holds_on_to_no_sweep() -> None:
    """A track keeps dozens of them."""
    seen = glimpse(0, (5.0, 4.0), points_of("back", 5000))
    held = (seen.view.frame.points_velo, seen.view.points_cam, seen.view.pixels, seen.view.above_m)
    for array in (*held, seen.view.ground.is_ground):
        owner = array if array.base is None else array.base
        assert owner.nbytes <= 480 * 3 * 8


def test_a_box_is_the_same_in_any_frame() -> None:
    boxes = np.array([CAR, [2.0, 9.0, 0.7, 4.0, 1.7, 1.5, 1.6]])
    a_SE3_b = pose(np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]), np.array([3.0, -1.0, 2.0]))
    there = transformed(boxes, a_SE3_b)
    moved = to_boxes(boxes).corners() @ a_SE3_b[:3, :3].T + a_SE3_b[:3, 3]
    assert np.allclose(to_boxes(there).corners(), moved)
    assert np.allclose(transformed(there, inverse(a_SE3_b)), boxes)


def test_edges_are_the_same_from_any_frame() -> None:
    box = np.array([[1.0, 14.0, 0.4, 4.0, 1.7, 1.5, 1.6]])
    calibration = KITTI_RIG.calibration
    there, there_slopes = project_edges(box, calibration.image_P_cam)
    a_SE3_cam = pose(np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]), np.array([30.0, -1.0, 2.0]))
    moved = transformed(box, a_SE3_cam)
    image_P_a = calibration.image_P_cam @ np.linalg.inv(a_SE3_cam)
    found, slopes = project_edges(moved, image_P_a)
    assert np.allclose(found, there)
    # Sizes and heading mean the same in both frames.
    assert np.allclose(slopes[..., YAW : HEIGHT + 1], there_slopes[..., YAW : HEIGHT + 1])
    step = 1e-6
    for column in range(7):
        aside = step * np.eye(7)[column]
        later, earlier = (project_edges(moved + sign * aside, image_P_a)[0] for sign in (1, -1))
        assert slopes[0, :, column] == pytest.approx((later - earlier)[0] / (2 * step), rel=1e-4, abs=1e-3)


def test_rays_of_each_point_start_where_it_was_seen() -> None:
    box = BevBoxes(*(torch.tensor(each, dtype=torch.float64) for each in ([0.0, 10.0], 4.0, 2.0, 0.0)))
    points = torch.tensor([[0.0, 9.0], [2.5, 10.0]], dtype=torch.float64)
    origins = torch.tensor([[0.0, 0.0], [12.0, 10.0]], dtype=torch.float64)
    distance, hit = ray_tracing(points, box, origins)
    alone = [ray_tracing(points[row : row + 1], box, origins[row]) for row in range(2)]
    assert distance.tolist() == [float(each[0]) for each, _ in alone]
    assert distance.tolist() == pytest.approx([0.0, 0.5])
    assert hit.tolist() == [bool(each) for _, each in alone]
    valid = torch.ones(2, dtype=torch.bool)
    same = balanced_loss(points, valid, box, origins[:1].expand(2, 2), PAPER.loss)
    assert same == balanced_loss(points, valid, box, origins[0], PAPER.loss)


def test_a_fit_with_rays_from_one_place_is_that_with_the_place_of_each_point() -> None:
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-0.8, 0.8, 40), np.full(40, 9.0)])
    one = FitProblem(points, 4.0, 1.7, np.pi / 2, np.zeros(2))
    each = FitProblem(points, 4.0, 1.7, np.pi / 2, np.zeros((40, 2)))
    for settings in (PAPER, ACCURATE):
        (a,), (b,) = (fit_boxes([p], settings.fit, settings.loss, 60) for p in (one, each))
        assert a.center_xz.tolist() == b.center_xz.tolist()
        assert a.losses == b.losses
    elsewhere = FitProblem(points, 4.0, 1.7, np.pi / 2, np.tile([20.0, 9.0], (40, 1)))
    (c,) = fit_boxes([elsewhere], PAPER.fit, PAPER.loss, 60)
    assert c.losses.ray_tracing != a.losses.ray_tracing
