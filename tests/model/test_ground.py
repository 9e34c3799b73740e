from __future__ import annotations

import numpy as np
import pytest

from boxlift.ground import find_ground, fit_plane
from boxlift.settings import PAPER
from model.small_frame import ground_points


def test_finds_a_tilted_plane_and_its_height() -> None:
    points = ground_points(np.random.default_rng(0))
    points[:, 1] += 0.05 * points[:, 2]  # 5 % downhill: y points down
    plane = fit_plane(points, PAPER.ground, seed=1)
    assert plane is not None
    expected_up = np.array([0, -1, 0.05]) / np.hypot(1, 0.05)
    assert np.rad2deg(np.arccos(plane.up @ expected_up)) < 0.5
    at_20_m = np.array([[0.0, 1.65 + 1.0, 20.0], [0.0, 1.65 + 1.0 - 1.5, 20.0]])
    assert plane.height_above(at_20_m).tolist() == pytest.approx([0, 1.5], abs=0.05)


def test_a_wall_with_more_points_than_the_road_is_not_the_ground() -> None:
    rng = np.random.default_rng(0)
    road = ground_points(rng, 2000)
    wall = np.stack([np.full(8000, 6.0), rng.uniform(-6, 1.6, 8000), rng.uniform(5, 45, 8000)], axis=1)
    ground = find_ground(np.concatenate([wall, road]), "frame", PAPER.ground)
    assert ground.found
    assert ground.is_ground[len(wall) :].mean() > 0.99
    assert ground.is_ground[: len(wall)].mean() < 0.1


def test_walls_only_means_no_ground() -> None:
    rng = np.random.default_rng(0)
    wall = np.stack([rng.uniform(-9, 9, 900), rng.uniform(-6, 1.6, 900), np.full(900, 20.0)], axis=1)
    ground = find_ground(wall, "frame", PAPER.ground)
    assert not ground.found
    assert not ground.is_ground.any()


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_points_for_a_plane(count: int) -> None:
    assert not find_ground(np.zeros((count, 3)), "frame", PAPER.ground).found


def test_points_on_one_line_make_no_plane() -> None:
    line = np.stack([np.zeros(50), np.zeros(50), np.linspace(5, 40, 50)], axis=1)
    ground = find_ground(line, "frame", PAPER.ground)
    assert ground.is_ground.shape == (50,)


def test_switched_off_removes_nothing() -> None:
    settings = PAPER.ground.model_copy(update={"remove": False})
    assert not find_ground(ground_points(np.random.default_rng(0)), "frame", settings).is_ground.any()


def test_the_name_of_the_frame_is_the_seed() -> None:
    points = ground_points(np.random.default_rng(0))
    points += np.random.default_rng(1).normal(scale=0.1, size=points.shape)
    planes = [find_ground(points, name, PAPER.ground).plane for name in ("a", "b", "a")]
    assert planes[0] is not None
    assert planes[1] is not None
    assert planes[2] is not None
    assert planes[0].up.tolist() == planes[2].up.tolist()
    assert planes[0].up.tolist() != planes[1].up.tolist()
