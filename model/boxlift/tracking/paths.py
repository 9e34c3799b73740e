"""Where an object was at every sweep of its track: one place if it stood, a smooth path if it moved.

A path is smoothed by a Kalman filter of constant velocity that runs forwards and back (Rauch, Tung and
Striebel, 1965), three times over, boxes far off it counting less each time. Along a path an object looks
where it goes; the headings of its boxes, which do not tell front from back, say the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from boxlift.boxes import wrap_angle
from boxlift.poses import Floats, pose
from boxlift.tracking.linking import Track
from boxlift.tracking.sightings import DriveSweep, Sighting

Rows = NDArray[np.intp]

_ROUNDS = 4
# A box this many standard deviations off counts half.
_HALF_AT = 2.0
_ACCELERATION_M_S2 = 3.0
_TURN_RAD_S2 = 1.0
# Standing are those whose boxes moved by less than this over the track, or by less than their errors; or
# crept at a speed that drifting boxes have.
_STILL_M, _STILL_SIGMAS = 1.0, 4.0
# Moving for sure are those that went farther than this, and than so many of their errors.
_FAR_M, _SURE_SIGMAS = 4.0, 8.0
_CREEP_M_S, _CREPT_M = 0.5, 2.5
# Boxes scatter by at least this share of their length, however even a few of them look.
_SCATTER_SHARE = 0.1
# People stand closer to where they stood, by this share.
_PEOPLE = 0.5
# Slower than this, direction of motion says nothing of the heading.
_SLOW_M_S = 1.0
_HEADING_RAD, _MOST_HEADINGS = np.deg2rad(6.0), 200
# Along a path: axes of boxes may be off by this over their length, within bounds; the direction of motion by
# that of a speed that is off by so much (m/s), and at least by this (rad).
_AXIS_RAD_M, _AXIS_RAD = 0.22, (0.04, 0.35)
_DIRECTION = 0.3, 0.05


class Motion(StrEnum):
    """What a track did; of a single box nobody knows."""

    STATIC = "static"
    MOVING = "moving"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class Path:
    """Poses of an object's frame: x to the front, y down, z to the left, at the middle of its bottom.

    first, last: sweeps between which they are known; of a standing object there is one for all sweeps.
    bottom_world, axes_world (K, 3) and (K, 3, 3). knows_front: whether motion told front from back.
    """

    motion: Motion
    first: int
    last: int
    bottom_world: Floats
    axes_world: Floats
    knows_front: bool

    @property
    def stands(self) -> bool:
        """Whether one pose is that of all sweeps."""
        return len(self.bottom_world) == 1

    def world_SE3_object(self, sweep: int) -> Floats:
        """(4, 4) at a sweep between first and last; of a standing object at any."""
        row = 0 if self.stands else sweep - self.first
        return pose(self.axes_world[row], self.bottom_world[row])


def paths_of(track: Track, sweeps: Sequence[DriveSweep]) -> tuple[Path, ...]:
    """The path that the boxes of a track show; two, the likelier first, where they leave in doubt whether it
    moved."""
    sightings = track.sightings
    if len(sightings) == 1:
        return (_standing(sightings, sweeps, Motion.UNKNOWN),)
    moved_m, sigma_m, speed_m_s = _displacement(sightings, sweeps)
    smaller = _PEOPLE if sightings[0].is_upright else 1.0
    crept = speed_m_s < smaller * _CREEP_M_S and moved_m < smaller * _CREPT_M
    moves = moved_m > max(smaller * _STILL_M, _STILL_SIGMAS * sigma_m) and not crept
    if not moves and moved_m < smaller * _STILL_M / 2:
        return (_standing(sightings, sweeps),)
    if moves and moved_m > max(smaller * _FAR_M, _SURE_SIGMAS * sigma_m):
        return (_moving(sightings, sweeps),)
    both = _standing(sightings, sweeps), _moving(sightings, sweeps)
    return both[::-1] if moves else both


def _displacement(sightings: Sequence[Sighting], sweeps: Sequence[DriveSweep]) -> tuple[float, float, float]:
    """How far a track went by a straight line through the bottoms of its boxes, the standard deviation of
    that, and the speed; metres and seconds."""
    times = np.array([sweeps[each.sweep].time_s for each in sightings])
    middle_s = times - times.mean()
    bottoms = np.array([_bottom(each) for each in sightings])[:, :2]
    sigma = np.array([each.sigma_m for each in sightings])
    weights = sigma**-2
    for _ in range(_ROUNDS):
        start = weights @ bottoms / weights.sum()
        spread = float(weights @ middle_s**2) - float(weights @ middle_s) ** 2 / float(weights.sum())
        velocity = (weights * middle_s) @ (bottoms - start) / max(spread, 1e-9)
        off = np.linalg.norm(bottoms - start - middle_s[:, None] * velocity, axis=1)
        weights = sigma**-2 / (1 + (off / sigma / _HALF_AT) ** 2)
    speed, lasted_s = float(np.linalg.norm(velocity)), float(np.ptp(times))
    least_m = _SCATTER_SHARE * float(np.median([max(each.lwh_m[:2]) for each in sightings]))
    scatter = max(float(np.sqrt(weights @ off**2 / weights.sum())), least_m)
    # Boxes of neighbouring sweeps err alike: as if every fourth told something new.
    sigma_m_s = scatter / max(float(np.std(times)) * np.sqrt(max(len(times) / 4, 1)), 1e-9)
    return speed * lasted_s, sigma_m_s * lasted_s, speed


def _robust_mean(sightings: Sequence[Sighting]) -> Floats:
    """Middle (3,) of the bottoms of boxes."""
    bottoms = np.array([_bottom(each) for each in sightings])
    sigma = np.array([each.sigma_m for each in sightings])
    weights = sigma**-2
    middle = bottoms[0]
    for _ in range(_ROUNDS):
        middle = weights @ bottoms / weights.sum()
        off = np.linalg.norm((bottoms - middle)[:, :2], axis=1) / sigma
        weights = sigma**-2 / (1 + (off / _HALF_AT) ** 2)
    place: Floats = middle
    return place


def _bottom(sighting: Sighting) -> Floats:
    bottom: Floats = sighting.center_world - np.array([0, 0, sighting.lwh_m[2] / 2])
    return bottom


def _standing(
    sightings: Sequence[Sighting], sweeps: Sequence[DriveSweep], motion: Motion = Motion.STATIC
) -> Path:
    bottom = _robust_mean(sightings)
    up = np.mean([sweeps[each.sweep].up_world for each in sightings], axis=0)
    heading = _common_axis(sightings)
    first, last = sightings[0].sweep, sightings[-1].sweep
    return Path(motion, first, last, bottom[None], _axes(np.array([heading]), up[None]), knows_front=False)


def _common_axis(sightings: Sequence[Sighting]) -> float:
    """The heading that most boxes have, front and back alike, the way most of them look."""
    headings = np.array([each.heading_rad for each in sightings])
    worth = np.array([each.score / each.sigma_m**2 for each in sightings]) + 1e-9
    # Every box votes for those that are turned against it by little; of many only some stand.
    standing = headings[:: -(-len(headings) // _MOST_HEADINGS)]
    turned = np.abs(wrap_angle(2 * (standing[:, None] - headings[None]))) / 2
    best = standing[int((worth / (1 + (turned / _HEADING_RAD) ** 2)).sum(1).argmax())]
    weights = worth / (1 + (wrap_angle(2 * (headings - best)) / 2 / _HEADING_RAD) ** 2)
    axis = best + weights @ (wrap_angle(2 * (headings - best)) / 2) / weights.sum()
    looks = float(worth @ np.cos(headings - axis))
    return float(axis if looks >= 0 else axis + np.pi)


def _moving(sightings: Sequence[Sighting], sweeps: Sequence[DriveSweep]) -> Path:
    first, last = sightings[0].sweep, sightings[-1].sweep
    times = np.array([sweep.time_s for sweep in sweeps[first : last + 1]])
    rows = np.array([each.sweep - first for each in sightings])
    sigma = np.array([each.sigma_m for each in sightings])
    bottoms = np.array([_bottom(each) for each in sightings])
    places, speeds = smooth(times, rows, bottoms, sigma, _ACCELERATION_M_S2)
    headings = _headings(times, rows, sightings, speeds[:, :2])
    ups = np.array([sweep.up_world for sweep in sweeps[first : last + 1]])
    return Path(Motion.MOVING, first, last, places, _axes(headings, ups), knows_front=True)


def _headings(times: Floats, rows: Rows, sightings: Sequence[Sighting], velocity_m_s: Floats) -> Floats:
    """(K,) headings along a path from the direction of motion and the axes of the boxes."""
    speed = np.linalg.norm(velocity_m_s, axis=1)
    direction = np.arctan2(velocity_m_s[:, 1], velocity_m_s[:, 0])
    fast = np.flatnonzero(speed > min(_SLOW_M_S, 0.7 * float(speed.max())))
    # Where it is slow it looks as when it was last fast.
    nearest = fast[np.abs(fast[None] - np.arange(len(times))[:, None]).argmin(1)]
    ahead = np.unwrap(direction[nearest])
    measured_rows, values, sigmas = [], [], []
    for row in fast:
        measured_rows.append(int(row))
        values.append(float(ahead[row]))
        sigmas.append(max(_DIRECTION[0] / float(speed[row]), _DIRECTION[1]))
    for row, each in zip(rows.tolist(), sightings, strict=True):
        axis = ahead[row] + float(wrap_angle(np.array(2 * (each.heading_rad - ahead[row])))) / 2
        measured_rows.append(int(row))
        values.append(axis)
        sigmas.append(_axis_sigma_rad(each) / max(each.score, 0.1))
    order = np.argsort(measured_rows, kind="stable")
    headings, _ = smooth(
        times,
        np.array(measured_rows)[order],
        np.array(values)[order, None],
        np.array(sigmas)[order],
        _TURN_RAD_S2,
    )
    return headings[:, 0]


def _axis_sigma_rad(sighting: Sighting) -> float:
    """How far the axis of a box may be off: the longer the box, the less."""
    longest, shortest = _AXIS_RAD
    return float(np.clip(_AXIS_RAD_M / sighting.lwh_m[0], longest, shortest))


def smooth(
    times: Floats, rows: Rows, values: Floats, sigmas: Floats, acceleration: float
) -> tuple[Floats, Floats]:
    """Values (M, D) with sigmas (M,), measured at times[rows], rows ascending -> values and velocities
    (K, D) at all times (K,)."""
    scale = np.ones(len(values))
    places, speeds = _rts(times, rows, values, sigmas, acceleration)
    for _ in range(_ROUNDS - 1):
        off = np.linalg.norm(values - places[rows], axis=1) / sigmas
        scale = np.sqrt(1 + (off / _HALF_AT) ** 2)
        places, speeds = _rts(times, rows, values, sigmas * scale, acceleration)
    return places, speeds


def _rts(
    times: Floats, rows: Rows, values: Floats, sigmas: Floats, acceleration: float
) -> tuple[Floats, Floats]:
    count, dimensions = len(times), values.shape[1]
    mean, covariance = np.zeros((2, dimensions)), np.diag([1e6, 1e4])
    mean[0] = values[0]
    means, covariances = np.empty((count, 2, dimensions)), np.empty((count, 2, 2))
    predicted_means, predicted = np.empty_like(means), np.empty_like(covariances)
    transitions = np.empty((count, 2, 2))
    measured = 0
    for k in range(count):
        step = float(times[k] - times[k - 1]) if k else 0.0
        transitions[k] = np.array([[1, step], [0, 1]])
        noise = np.array([[step**3 / 3, step**2 / 2], [step**2 / 2, step]]) * acceleration**2
        mean = transitions[k] @ mean
        covariance = transitions[k] @ covariance @ transitions[k].T + noise
        predicted_means[k], predicted[k] = mean, covariance
        while measured < len(rows) and rows[measured] == k:
            gain = covariance[:, 0] / (covariance[0, 0] + sigmas[measured] ** 2)
            mean = mean + np.outer(gain, values[measured] - mean[0])
            covariance = covariance - np.outer(gain, covariance[0])
            measured += 1
        means[k], covariances[k] = mean, covariance
    for k in range(count - 2, -1, -1):
        back = covariances[k] @ transitions[k + 1].T @ np.linalg.inv(predicted[k + 1])
        means[k] += back @ (means[k + 1] - predicted_means[k + 1])
    return means[:, 0], means[:, 1]


def _axes(headings_rad: Floats, ups_world: Floats) -> Floats:
    """(K, 3, 3) axes of object frames as columns: front, down, left."""
    down = -ups_world / np.linalg.norm(ups_world, axis=1, keepdims=True)
    flat = np.stack([np.cos(headings_rad), np.sin(headings_rad), np.zeros_like(headings_rad)], axis=1)
    front = flat - (flat * down).sum(1, keepdims=True) * down
    front /= np.linalg.norm(front, axis=1, keepdims=True)
    return np.stack([front, down, np.cross(front, down)], axis=2)
