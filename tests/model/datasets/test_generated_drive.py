"""Generated drives: traffic keeps apart and moves as told, and files hold what was seen."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np

from boxlift.datasets import open_source
from boxlift.datasets.generated import DriveSettings, generate_drive, write_drive
from boxlift.datasets.generated.scene import build_scene, footprint, overlap
from boxlift.datasets.generated.traffic import Traffic
from boxlift.formats.kitti_tracks import read_tracks
from model.tracking.drives import SMALL_RIG, drive


def test_nobody_drives_through_anybody() -> None:
    for seed in range(6):
        traffic = Traffic(build_scene(seed), seed, 8.0)
        before = {item.bottom_center for item in traffic.scene().objects}
        for _ in range(100):
            traffic.advance(0.05)
        objects = traffic.scene().objects
        assert before != {item.bottom_center for item in objects}
        marks = [footprint(o.bottom_center[:2], o.heading_rad, o.size_lwh_m[:2]) for o in objects]
        marks.append(traffic.own.footprint())
        assert not any(overlap(*pair) for pair in combinations(marks, 2))


def test_what_parks_stays_and_what_drives_goes_where_it_looks() -> None:
    traffic = Traffic(build_scene(3), 3, 8.0)
    before = traffic.scene().objects
    for _ in range(20):
        traffic.advance(0.05)
    for earlier, later in zip(before, traffic.scene().objects, strict=True):
        moved = np.subtract(later.bottom_center, earlier.bottom_center)[:2]
        if earlier.role == "standing":
            assert later == earlier
        elif np.linalg.norm(moved) > 1:
            ahead = np.array([np.cos(earlier.heading_rad), np.sin(earlier.heading_rad)])
            assert moved @ ahead / np.linalg.norm(moved) > 0.9


def test_the_own_car_drives_at_its_speed() -> None:
    first, last = drive(3).sweeps[0], drive(3).sweeps[-1]
    views = [each.generated.frame.view for each in (first, last)]
    places = [view.world_SE3_ego[:3, 3] for view in views if view and view.world_SE3_ego is not None]
    assert abs(np.linalg.norm(places[1] - places[0]) - 0.8 * 13) < 0.3


def test_a_drive_is_read_as_it_was_generated(tmp_path: Path) -> None:
    sweeps = list(generate_drive(3, SMALL_RIG, DriveSettings(sweeps=3)))
    assert write_drive(tmp_path, "0003", sweeps) == 3
    source = open_source(tmp_path)
    assert source.names == ("0003_000000", "0003_000001", "0003_000002")
    tracks = read_tracks(tmp_path / "training" / "label_02" / "0003.txt")
    for number, (name, sweep) in enumerate(zip(source.names, sweeps, strict=True)):
        frame, own = source.load(name, with_image=True), sweep.generated.frame
        assert np.array_equal(frame.points_velo, own.points_velo)
        assert np.array_equal(frame.image, own.image)  # type: ignore[arg-type]
        assert [(each.track, each.line.box_px) for each in tracks[number] if each.line.has_box3d] == [
            (track, line.box_px) for track, line in sweep.tracked
        ]


def test_the_same_seed_is_the_same_drive() -> None:
    settings = DriveSettings(sweeps=2)
    first, second = (list(generate_drive(5, SMALL_RIG, settings, with_images=False)) for _ in range(2))
    for a, b in zip(first, second, strict=True):
        assert np.array_equal(a.generated.frame.points_velo, b.generated.frame.points_velo)
        assert a.tracks == b.tracks
        assert a.generated.truth == b.generated.truth
