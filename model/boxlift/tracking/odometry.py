"""Where the sweeps of a drive were taken, from their points: KISS-ICP's scan matching.

Poses of a GPS/IMU drift against each other by decimetres within seconds, and their mounting is known to a
degree: enough for a map, too little for the sides of a car. They say where a sweep is looked for; the match
says where it is. Without any, the last motion says it.

What lies on the ground is left out: its rings of points go with the sensor, and hold a match back where there
is little beside the road (by a fifth of the way and more on generated drives, benchmarks/odometry.py).

Source: Vizzo et al., "KISS-ICP", IEEE Robotics and Automation Letters 8 (2), 2023.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice, pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from boxlift.errors import DatasetError, MissingExtraError
from boxlift.poses import inverse, pose

if TYPE_CHECKING:
    from boxlift.poses import Floats

# Cells of the map: those of KISS-ICP for a range of 100 m are twice as large; half of it costs little, and
# a car has edges.
_VOXEL_M = 0.5
_FEWEST_POINTS = 200
# Of what stands around a sweep the next one shows at least this share, by the median of so many pairs or
# more: .8 at 12 m/s and two sweeps a second, .2 between frames of different places.
_LEAST_SHARED, _FEWEST_PAIRS = 0.5, 3
# Points lower than this above the lowest in their cell and those around it may be ground.
_CELL_M, _OFF_GROUND_M = 1.0, 0.3
_NEAREST_M, _FARTHEST_M = 2.5, 100.0
# The motion before the first sweep is not known: so many are matched to learn it, and then matched again.
_LEARNED_FROM = 10
# A match that is off its guess by more than this much a sweep is none: the guess is taken.
_LARGEST_CORRECTION_M, _LARGEST_CORRECTION_RAD = 1.0, np.deg2rad(5.0)


@dataclass(frozen=True)
class UnmatchedSweep:
    """points_ego (N, 3+) of a sweep, what a data set says of its pose, and which way is up (3,)."""

    points_ego: NDArray[np.floating]
    world_SE3_ego: Floats | None
    up_ego: tuple[float, float, float] = (0.0, 0.0, 1.0)


def matched_poses(sweeps: Iterable[UnmatchedSweep]) -> Iterator[Floats]:
    """world_SE3_ego (4, 4) of the sweeps of one drive, in their order.

    The world is that of the data set's poses at the first sweep, else the first sweep's ego frame. Poses are
    good among neighbours; over a drive they drift, as odometry does. Raises MissingExtraError, and
    DatasetError where the first sweeps show nothing of each other's surroundings.
    """
    waiting = iter(sweeps)
    first = list(islice(waiting, _LEARNED_FROM))
    if not first:
        return
    matcher = _Matcher()
    if any(sweep.world_SE3_ego is None for sweep in first):
        for sweep in first:
            matcher.match(sweep)
        matcher = _Matcher(matcher.last_motion)
    matched = [matcher.match(sweep) for sweep in first]
    _require_following(first, matched)
    start = first[0].world_SE3_ego
    start = np.eye(4) if start is None else start
    world_SE3_map = start @ inverse(matched[0])
    for pose_ in matched:
        yield world_SE3_map @ pose_
    for sweep in waiting:
        yield world_SE3_map @ matcher.match(sweep)


class _Matcher:
    """KISS-ICP, told where to look."""

    def __init__(self, last_motion: Floats | None = None) -> None:
        config, pipeline = _kiss_icp()
        settings = config()
        settings.data.deskew = False  # the points of a sweep have no times here
        settings.data.min_range, settings.data.max_range = _NEAREST_M, _FARTHEST_M
        settings.mapping.voxel_size = _VOXEL_M
        # More threads sum in another order each time.
        settings.registration.max_num_threads = 1
        self._pipeline = pipeline(settings)
        if last_motion is not None:
            self._pipeline.last_delta = _rigid(last_motion)
        self._before: Floats | None = None

    @property
    def last_motion(self) -> Floats:
        """(4, 4) from the last sweep but one to the last."""
        motion: Floats = self._pipeline.last_delta
        return motion

    def match(self, sweep: UnmatchedSweep) -> Floats:
        """map_SE3_ego of the next sweep."""
        told = sweep.world_SE3_ego
        if told is not None and self._before is not None:
            self._pipeline.last_delta = _rigid(inverse(self._before) @ told)
        self._before = told
        guess: Floats = self._pipeline.last_pose @ self._pipeline.last_delta
        points = off_ground(np.asarray(sweep.points_ego[:, :3], dtype=np.float64), np.array(sweep.up_ego))
        if len(points) < _FEWEST_POINTS:
            self._pipeline.last_pose = _rigid(guess)
            return guess
        self._pipeline.register_frame(points, np.empty(0))
        if told is not None and _is_far(inverse(guess) @ self._pipeline.last_pose):
            self._pipeline.last_pose = _rigid(guess)
        found: Floats = self._pipeline.last_pose
        return found


def off_ground(points: Floats, up: Floats) -> Floats:
    """Those of (N, 3) points that stand higher than the ground around them; all where they are few. up: (3,)
    unit vector."""
    if len(points) == 0:
        return points
    # Two axes across `up`: its row of a complete basis is the last.
    _, _, basis = np.linalg.svd(up[None])
    height = points @ up
    cells = np.floor(points @ basis[1:].T / _CELL_M).astype(np.int64)
    cells -= cells.min(axis=0) - 1  # an empty cell all around
    lowest = np.full(cells.max(axis=0) + 2, np.inf)
    np.minimum.at(lowest, tuple(cells.T), height)
    around = lowest.copy()
    for axis in (0, 1):
        around = np.minimum(around, np.minimum(np.roll(around, 1, axis), np.roll(around, -1, axis)))
    standing = np.ascontiguousarray(points[height > around[tuple(cells.T)] + _OFF_GROUND_M])
    return standing if len(standing) >= _FEWEST_POINTS else np.ascontiguousarray(points)


def _require_following(sweeps: Sequence[UnmatchedSweep], poses: Sequence[Floats]) -> None:
    """Raises DatasetError where sweeps are of different places, however they were matched."""
    standing = [
        off_ground(np.asarray(sweep.points_ego[:, :3], dtype=np.float64), np.array(sweep.up_ego))
        for sweep in sweeps
    ]
    placed = [points @ pose_[:3, :3].T + pose_[:3, 3] for points, pose_ in zip(standing, poses, strict=True)]
    shared = [
        shared_surroundings(before, after)
        for before, after in pairwise(placed)
        if min(len(before), len(after)) >= _FEWEST_POINTS
    ]
    if len(shared) >= _FEWEST_PAIRS and np.median(shared) < _LEAST_SHARED:
        raise DatasetError(
            "sweeps",
            "the frames do not follow each other (of what stood around one the next shows "
            f"{100 * np.median(shared):.0f} %).",
            "Track the frames of a drive in the order of their times, at least two a second.",
        )


def shared_surroundings(before: Floats, after: Floats) -> float:
    """Share in [0, 1] of the cells of one of two clouds (N, 3), (M, 3) that lie in or beside cells of the
    other; of the cloud that shares more, for one may be cut to a camera's view."""
    cells, others = (
        np.unique(np.floor(cloud / _VOXEL_M).astype(np.int64), axis=0) for cloud in (before, after)
    )
    around = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3), axis=-1).reshape(-1, 1, 3)
    # Cells as numbers; a cloud is less than 2^20 cells wide.
    low = np.minimum(cells.min(axis=0), others.min(axis=0)) - 1
    keys = np.array([1 << 40, 1 << 20, 1])
    shares = [
        np.isin((own - low) @ keys, ((other + around).reshape(-1, 3) - low) @ keys).mean()
        for own, other in ((cells, others), (others, cells))
    ]
    return float(max(shares))


def _is_far(correction: Floats) -> bool:
    turned = np.arccos(np.clip((np.trace(correction[:3, :3]) - 1) / 2, -1, 1))
    return bool(np.linalg.norm(correction[:3, 3]) > _LARGEST_CORRECTION_M or turned > _LARGEST_CORRECTION_RAD)


def _rigid(matrix: Floats) -> Floats:
    """The nearest rigid transform: KISS-ICP ends the process where a rotation is off by more than 1e-9."""
    left, _, right = np.linalg.svd(matrix[:3, :3])
    return pose(left @ right, matrix[:3, 3])


def _kiss_icp() -> tuple[Any, Any]:
    try:
        from kiss_icp.config import KISSConfig
        from kiss_icp.kiss_icp import KissICP
    except ImportError:
        raise MissingExtraError("kiss-icp", "track") from None
    return KISSConfig, KissICP
