"""Where sweeps were taken: by the data set, and by matching them.

    python benchmarks/odometry.py

Real: how far the truth of parked vehicles wanders in the world along a drive (standard deviation along
and across the first heading, median over the tracks with more than five boxes), by GPS/IMU and matched.
Generated: by how much a step of a drive is off, and its end, with all points and with those off the ground.
"""

from __future__ import annotations

import tempfile
from collections import defaultdict
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from unittest.mock import patch

import numpy as np

from boxlift.camera import Floats
from boxlift.datasets import FrameSource, open_source
from boxlift.datasets.generated import DriveSettings, generate_drive
from boxlift.formats.ego_boxes import ego_objects_of_kitti
from boxlift.formats.kitti_tracks import TrackedObject
from boxlift.poses import inverse
from boxlift.tracking import odometry
from boxlift.tracking.odometry import UnmatchedSweep, matched_poses
from kitti_drives import drives_of, lay_out, truths_of

_SEEDS = (300, 301, 303, 306)
_PARKED_M = 1.5
_FEWEST_BOXES = 5


def print_real() -> None:
    """The wandering of what is parked."""
    with tempfile.TemporaryDirectory() as folder:
        source = open_source(lay_out(Path(folder)))
        for drive in drives_of():
            names = list(truths_of(drive))
            frames = [source.load(name) for name in names]
            told = [frame.view.world_SE3_ego for frame in frames if frame.view is not None]
            poses = {"GPS/IMU": [each for each in told if each is not None]}
            sweeps = [
                UnmatchedSweep(frame.points_velo, pose)
                for frame, pose in zip(frames, poses["GPS/IMU"], strict=True)
            ]
            poses["matched near them"] = list(matched_poses(sweeps))
            poses["matched without"] = list(
                matched_poses(UnmatchedSweep(each.points_ego, None) for each in sweeps)
            )
            for which, found in poses.items():
                spread = _spread(source, truths_of(drive), found)
                cells = ", ".join(
                    f"{value:.3f} m {axis}" for value, axis in zip(spread, ("along", "across"), strict=True)
                )
                print(f"{drive.name} {which:18} parked vehicles wander by {cells}")


def _spread(source: FrameSource, truths: dict[str, list[TrackedObject]], poses: Sequence[Floats]) -> Floats:
    places = defaultdict(list)
    for (name, objects), pose in zip(truths.items(), poses, strict=True):
        view = source.load(name).view
        assert view is not None
        boxes = ego_objects_of_kitti([each.line for each in objects], view.ego_SE3_cam)
        for each, box in zip(objects, boxes, strict=True):
            world = pose[:3, :3] @ box.center_ego + pose[:3, 3]
            places[each.track].append((inverse(poses[0])[:3, :3] @ world)[:2])
    spreads = [np.std(each, axis=0) for each in places.values() if len(each) > _FEWEST_BOXES]
    parked = np.array([each for each in spreads if np.linalg.norm(each) < _PARKED_M])
    median: Floats = np.median(parked, axis=0)
    return median


def print_generated() -> None:
    """The errors of steps and ends."""
    for seed in _SEEDS:
        sweeps = list(generate_drive(seed, settings=DriveSettings(sweeps=40), with_images=False))
        views = [each.generated.frame.view for each in sweeps]
        true = [view.world_SE3_ego for view in views if view is not None and view.world_SE3_ego is not None]
        unmatched = [UnmatchedSweep(each.generated.frame.points_velo, None) for each in sweeps]
        _print_errors(f"{seed} off the ground", true, list(matched_poses(unmatched)))
        with patch.object(odometry, "off_ground", lambda points, _: np.ascontiguousarray(points)):
            _print_errors(f"{seed} all points", true, list(matched_poses(unmatched)))


def _print_errors(title: str, true: Sequence[Floats], found: Sequence[Floats]) -> None:
    steps = [
        np.linalg.norm((inverse(inverse(a) @ b) @ inverse(c) @ d)[:3, 3])
        for (a, b), (c, d) in zip(pairwise(true), pairwise(found), strict=True)
    ]
    way = inverse(true[0]) @ true[-1]
    off = np.linalg.norm((inverse(way) @ inverse(found[0]) @ found[-1])[:3, 3])
    print(
        f"{title:22} a step is off by {np.median(steps):.3f} m (median), the end by {off:.2f} of "
        f"{np.linalg.norm(way[:3, 3]):.1f} m"
    )


if __name__ == "__main__":
    print_real()
    print_generated()
