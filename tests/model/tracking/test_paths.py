"""What stands has a place, what moves a path, and which it is shows in its boxes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from boxlift.boxes import wrap_angle
from boxlift.camera import Floats
from boxlift.tracking.linking import Track
from boxlift.tracking.paths import Motion, paths_of, smooth
from boxlift.tracking.sightings import DriveSweep, Sighting
from model.tracking.test_linking import CAR, PERSON, sighting

UP = np.array([0.0, 0.0, 1.0])


def sweeps(count: int, period_s: float = 0.1) -> list[DriveSweep]:
    return [DriveSweep(n, n * period_s, np.eye(4), UP, (f"{n}",)) for n in range(count)]


def track_of(
    places: Floats, headings: Floats | None = None, lwh_m: tuple[float, float, float] = CAR
) -> Track:
    own = [sighting(n, x, y, lwh_m=lwh_m) for n, (x, y) in enumerate(places)]
    if headings is not None:
        own = [replace(each, heading_rad=float(yaw)) for each, yaw in zip(own, headings, strict=True)]
    return Track(tuple(own))


def scattered(places: Floats, sigma_m: float = 0.2) -> Floats:
    noisy: Floats = places + np.random.default_rng(3).normal(0, sigma_m, places.shape)
    return noisy


def test_what_stands_is_where_most_boxes_have_it() -> None:
    places = scattered(np.tile([20.0, 5.0], (30, 1)))
    places[7] = (26.0, 5.0)
    (path,) = paths_of(track_of(places), sweeps(30))
    assert path.motion is Motion.STATIC
    assert not path.knows_front
    assert path.world_SE3_object(0)[:2, 3] == pytest.approx([20, 5], abs=0.12)
    assert path.world_SE3_object(0)[2, 3] == pytest.approx(0, abs=1e-9)
    assert np.array_equal(path.world_SE3_object(0), path.world_SE3_object(29))


def test_a_drifting_box_of_a_parked_car_is_no_motion() -> None:
    """Boxes of far cars move by a metre as the own car comes nearer."""
    drift = np.column_stack([np.linspace(40, 41.2, 40), np.zeros(40)])
    assert paths_of(track_of(scattered(drift)), sweeps(40))[0].motion is Motion.STATIC


def test_what_drives_looks_ahead_whichever_way_its_boxes_look() -> None:
    time = np.arange(30) * 0.1
    places = np.column_stack([10 + 8 * time, 0.5 * 1.2 * time**2])
    direction = np.arctan2(1.2 * time, 8)
    boxes = direction + np.pi * (np.arange(30) % 2) + np.random.default_rng(0).normal(0, 0.1, 30)
    (path,) = paths_of(track_of(scattered(places), boxes), sweeps(30))
    assert path.motion is Motion.MOVING
    assert path.knows_front
    off = []
    for n in range(30):
        pose = path.world_SE3_object(n)
        assert np.linalg.norm(pose[:2, 3] - places[n]) < 0.45
        looks = np.arctan2(pose[1, 0], pose[0, 0])
        off.append(abs(float(wrap_angle(looks - direction[n]))))
        assert np.allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3))
        assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)
        assert pose[:3, 1] == pytest.approx([0, 0, -1], abs=1e-6)
    assert max(off) < 0.2
    assert np.median(off) < 0.06


def test_the_path_goes_through_gaps() -> None:
    places = np.column_stack([10 + 0.8 * np.arange(30), np.zeros(30)])
    whole = track_of(scattered(places))
    gappy = Track(tuple(each for each in whole.sightings if not 10 <= each.sweep < 16))
    (path,) = paths_of(gappy, sweeps(30))
    for n in range(10, 16):
        assert np.linalg.norm(path.world_SE3_object(n)[:2, 3] - places[n]) < 0.4


def test_a_car_that_waits_and_then_drives_off_looks_ahead_all_the_time() -> None:
    x = np.concatenate([np.zeros(15), 0.5 * 3 * (np.arange(25) * 0.1) ** 2])
    path = paths_of(track_of(scattered(np.column_stack([20 + x, 0 * x]), 0.1)), sweeps(40))[0]
    assert path.motion is Motion.MOVING
    for n in range(40):
        assert path.world_SE3_object(n)[0, 0] > 0.95


def test_people_move_who_cars_would_stand() -> None:
    places = np.column_stack([10 + 0.13 * np.arange(10), np.zeros(10)])
    assert paths_of(track_of(places, lwh_m=PERSON), sweeps(10))[0].motion is Motion.MOVING
    assert paths_of(track_of(places), sweeps(10))[0].motion is Motion.STATIC


def test_where_it_is_in_doubt_both_are_told() -> None:
    places = scattered(np.column_stack([20 + 0.25 * np.arange(12), np.zeros(12)]))
    found = {path.motion for path in paths_of(track_of(places), sweeps(12))}
    assert found == {Motion.STATIC, Motion.MOVING}


def test_of_a_single_box_nobody_knows() -> None:
    (path,) = paths_of(track_of(np.array([[20.0, 1.0]])), sweeps(1))
    assert path.motion is Motion.UNKNOWN


def test_sweeps_of_one_moment_are_no_division_by_zero() -> None:
    still = [DriveSweep(n, 0.0, np.eye(4), UP, ()) for n in range(5)]
    places = scattered(np.tile([20.0, 5.0], (5, 1)))
    assert np.isfinite(paths_of(track_of(places), still)[0].world_SE3_object(2)).all()


def test_what_stands_for_an_hour_costs_no_gigabytes() -> None:
    """As before a camera that stands too: 36,000 sweeps."""
    count = 36_000
    headings = np.tile([0.3, 0.31, 0.29, 0.3 + np.pi, 1.8], count // 5)
    (path,) = paths_of(track_of(np.tile([20.0, 5.0], (count, 1)), headings), sweeps(count))
    front = path.world_SE3_object(0)[:2, 0]
    assert np.arctan2(front[1], front[0]) == pytest.approx(0.3, abs=0.02)


def test_smoothing_ignores_what_is_far_off() -> None:
    times = np.linspace(0, 3.9, 40)
    true = np.column_stack([3 * times, np.sin(times)])
    measured = scattered(true, 0.1)
    measured[11] += (0.0, 8.0)
    places, speeds = smooth(times, np.arange(40), measured, np.full(40, 0.1), 2.0)
    assert np.abs(places - true).max() < 0.25
    assert speeds[20] == pytest.approx([3, np.cos(times[20])], abs=0.5)


def test_a_slope_tilts_what_stands_on_it() -> None:
    tilted = np.array([0.1, 0.0, 1.0]) / np.linalg.norm([0.1, 0, 1])
    on_slope = [replace(each, up_world=tilted) for each in sweeps(5)]
    (path,) = paths_of(track_of(np.tile([20.0, 5.0], (5, 1))), on_slope)
    assert path.world_SE3_object(0)[:3, 1] == pytest.approx(-tilted)


def test_sightings_know_how_far_they_may_be_off() -> None:
    near, far, doubtful, cut = (
        Sighting(0, (), "Car", score, np.zeros(3), 0.0, CAR, range_m, is_cut).sigma_m
        for score, range_m, is_cut in ((1.0, 10, False), (1.0, 60, False), (0.1, 10, False), (1.0, 10, True))
    )
    assert near < min(far, doubtful, cut)
