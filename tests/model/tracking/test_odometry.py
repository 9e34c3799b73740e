"""Matched sweeps lie where they were taken."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from boxlift.camera import Floats
from boxlift.errors import DatasetError
from boxlift.poses import about_z, inverse, pose
from boxlift.tracking.odometry import (
    UnmatchedSweep,
    matched_poses,
    off_ground,
    shared_surroundings,
)
from model.tracking.drives import Drive, drive


def truth(driven: Drive) -> list[Floats]:
    views = (each.generated.frame.view for each in driven.sweeps)
    return [view.world_SE3_ego for view in views if view is not None and view.world_SE3_ego is not None]


def points(driven: Drive) -> list[Floats]:
    return [each.generated.frame.points_velo[:, :3].astype(np.float64) for each in driven.sweeps]


def steps(poses: list[Floats]) -> list[Floats]:
    return [inverse(before) @ after for before, after in pairwise(poses)]


def errors_m(found: list[Floats], true: list[Floats]) -> Floats:
    return np.array(
        [np.linalg.norm((inverse(a) @ b)[:3, 3]) for a, b in zip(steps(true), steps(found), strict=True)]
    )


def test_without_poses_every_step_is_known_to_centimetres() -> None:
    driven = drive(3)
    found = list(matched_poses(UnmatchedSweep(each, None) for each in points(driven)))
    assert np.allclose(found[0], np.eye(4))
    # Also the first: the own car drives at 8 m/s before anything is known of it.
    assert errors_m(found, truth(driven)).max() < 0.06


def test_poses_that_drift_are_put_right_and_the_world_stays_theirs() -> None:
    driven = drive(3)
    rng = np.random.default_rng(0)
    told = [
        each @ pose(about_z(rng.normal(0, 0.005)), np.array([*rng.normal(0, 0.15, 2), 0.0]))
        for each in truth(driven)
    ]
    sweeps = [UnmatchedSweep(*pair) for pair in zip(points(driven), told, strict=True)]
    found = list(matched_poses(sweeps))
    assert np.allclose(found[0], told[0])
    assert errors_m(found, truth(driven)).max() < 0.06 < errors_m(told, truth(driven)).max()


def test_a_match_that_is_far_off_what_the_data_set_says_is_not_believed() -> None:
    """As in a sweep of something else."""
    driven = drive(3)
    clouds = points(driven)
    clouds[2] = clouds[2] @ about_z(1.2).T + np.array([30.0, 0, 0])
    sweeps = [UnmatchedSweep(*pair) for pair in zip(clouds, truth(driven), strict=True)]
    found = list(matched_poses(sweeps))
    assert errors_m(found[:3], truth(driven)[:3]).max() < 1.0


@pytest.mark.parametrize("count", [0, 1, 50])
def test_sweeps_with_hardly_a_point_go_on_as_before(count: int) -> None:
    driven = drive(3, 4)
    clouds = points(driven)
    clouds[2] = clouds[2][:count]
    found = list(matched_poses(UnmatchedSweep(each, None) for each in clouds))
    assert len(found) == 4
    assert errors_m(found, truth(driven)).max() < 0.3


def test_nothing_is_nowhere() -> None:
    assert list(matched_poses([])) == []
    (only,) = matched_poses([UnmatchedSweep(np.zeros((0, 3)), None)])
    assert np.allclose(only, np.eye(4))


def test_poses_written_with_few_digits_end_no_process() -> None:
    """KISS-ICP aborts where a rotation is not orthonormal to nine digits."""
    driven = drive(3, 4)
    told = [each.round(4) for each in truth(driven)]
    sweeps = [UnmatchedSweep(*pair) for pair in zip(points(driven), told, strict=True)]
    assert len(list(matched_poses(sweeps))) == 4


def test_the_same_sweeps_are_at_the_same_places() -> None:
    clouds = points(drive(3, 4))
    first, second = (list(matched_poses(UnmatchedSweep(each, None) for each in clouds)) for _ in range(2))
    assert np.array_equal(first, second)


def test_what_lies_on_the_ground_is_left_out_whichever_way_is_up() -> None:
    rng = np.random.default_rng(0)
    road = np.column_stack([rng.uniform(-20, 20, (4000, 2)), rng.normal(0, 0.02, 4000)])
    post = np.column_stack([np.full((400, 2), 5.5), rng.uniform(0.5, 3, 400)])
    cloud = np.concatenate([road, post])
    assert off_ground(cloud, np.array([0, 0, 1.0])).tolist() == post.tolist()
    turned = cloud[:, [2, 0, 1]]
    assert off_ground(turned, np.array([1.0, 0, 0])).tolist() == post[:, [2, 0, 1]].tolist()
    # With nothing beside the road, the road it is.
    assert len(off_ground(road, np.array([0, 0, 1.0]))) == len(road)


def test_frames_of_different_places_are_no_drive() -> None:
    clouds = [points(drive(seed, 1))[0] for seed in (3, 300, 306, 7, 9)]
    with pytest.raises(DatasetError, match="do not follow each other"):
        list(matched_poses(UnmatchedSweep(each, None) for each in clouds))


def test_two_sweeps_a_second_are_one() -> None:
    clouds = points(drive(3))[::5]
    assert len(list(matched_poses(UnmatchedSweep(each, None) for each in clouds))) == 3


def test_a_sweep_cut_to_the_view_shares_what_is_in_it() -> None:
    whole = off_ground(points(drive(3))[0], np.array([0, 0, 1.0]))
    ahead = whole[(whole[:, 0] > 0) & (np.abs(whole[:, 1]) < whole[:, 0])]
    assert shared_surroundings(whole, ahead) == shared_surroundings(ahead, whole) == 1.0
    assert shared_surroundings(whole, whole + np.array([0, 0, 200.0])) == 0.0
