"""Boxes of a drive -> tracks: which of them are the same object.

Sweep by sweep, nearest first: every track predicts where its object is by a Kalman filter of constant
velocity seen from above, and takes the box that is least off in standard deviations (Weng et al., "3D
Multi-Object Tracking: A Baseline and New Evaluation Metrics", IROS 2020; taken greedily as by Chiu et al.,
2020). Afterwards tracks that end and begin in one place, with a gap between, are one: what stood there stands
there.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from boxlift.poses import Floats
from boxlift.tracking.sightings import Sighting

# A box farther off than this many standard deviations is another object's.
_GATE = 3.0
# Accelerations that road users have, and speeds they may have when they are first seen.
_ACCELERATION_M_S2 = 3.0
_SPEED_M_S, _PEOPLES_SPEED_M_S = 8.0, 2.0
# What is hidden for longer is found again only where it stands; the motion of a track that has few boxes is
# not known for so long.
_LONGEST_GAP_S, _GAP_PER_SIGHTING_S = 1.5, 0.25
# Of one object boxes of different classes may be, but not of such different lengths.
_LENGTH_RATIO = 3.0
# Tracks are stitched where they stand this close, by the longer side of the box, within this time.
_STITCH_SHARE, _LONGEST_STITCH_S = 0.5, 30.0
_STANDING_M_S = 0.5


@dataclass(frozen=True)
class Track:
    """One object: its sightings, at most one a sweep, in the order of time."""

    sightings: tuple[Sighting, ...]

    @property
    def category(self) -> str:
        """The class that most of its boxes have, by score."""
        votes: defaultdict[str, float] = defaultdict(float)
        for each in self.sightings:
            votes[each.category] += each.score
        return max(sorted(votes), key=lambda name: votes[name])


@dataclass(eq=False)
class _Filter:
    """A Kalman filter of position and velocity, x and y alike: mean (2, 2), covariance (2, 2), at time_s."""

    mean: Floats
    covariance: Floats
    time_s: float
    sightings: list[Sighting] = field(default_factory=list)

    @classmethod
    def begun(cls, sighting: Sighting, time_s: float) -> _Filter:
        speed = _PEOPLES_SPEED_M_S if sighting.is_upright else _SPEED_M_S
        return cls(
            np.stack([sighting.center_world[:2], np.zeros(2)]),
            np.diag([sighting.sigma_m**2, speed**2]),
            time_s,
            [sighting],
        )

    @property
    def longest_gap_s(self) -> float:
        return min(_LONGEST_GAP_S, _GAP_PER_SIGHTING_S * len(self.sightings))

    def predict(self, time_s: float) -> None:
        step = time_s - self.time_s
        transition = np.array([[1, step], [0, 1]])
        noise = np.array([[step**3 / 3, step**2 / 2], [step**2 / 2, step]]) * _ACCELERATION_M_S2**2
        self.mean = transition @ self.mean
        self.covariance = transition @ self.covariance @ transition.T + noise
        self.time_s = time_s

    def off(self, sighting: Sighting) -> float:
        """How far a box is off the prediction, in standard deviations; infinite for one of another kind."""
        ratio = sighting.lwh_m[0] / self.sightings[-1].lwh_m[0]
        if not 1 / _LENGTH_RATIO < ratio < _LENGTH_RATIO:
            return np.inf
        variance = self.covariance[0, 0] + sighting.sigma_m**2
        return float(np.linalg.norm(sighting.center_world[:2] - self.mean[0]) / np.sqrt(variance))

    def take(self, sighting: Sighting) -> None:
        gain = self.covariance[:, 0] / (self.covariance[0, 0] + sighting.sigma_m**2)
        self.mean = self.mean + np.outer(gain, sighting.center_world[:2] - self.mean[0])
        self.covariance = self.covariance - np.outer(gain, self.covariance[0])
        self.sightings.append(sighting)


def link(sweeps: Iterable[tuple[float, Sequence[Sighting]]]) -> list[Track]:
    """Times in seconds and boxes of the sweeps of a drive -> its tracks, by their first sighting."""
    active: list[_Filter] = []
    ended: list[_Filter] = []
    times: list[float] = []
    for time_s, sightings in sweeps:
        times.append(time_s)
        silent = [time_s - times[track.sightings[-1].sweep] > track.longest_gap_s for track in active]
        ended += [track for track, is_lost in zip(active, silent, strict=True) if is_lost]
        active = [track for track, is_lost in zip(active, silent, strict=True) if not is_lost]
        for track in active:
            track.predict(time_s)
        active += _assign(active, sightings, time_s)
    tracks = [Track(tuple(track.sightings)) for track in (*ended, *active)]
    return _stitched(sorted(tracks, key=_first), times)


def _assign(active: Sequence[_Filter], sightings: Sequence[Sighting], time_s: float) -> list[_Filter]:
    """Hand the boxes of a sweep to the tracks; those that none takes begin new ones."""
    off = np.array([[track.off(sighting) for sighting in sightings] for track in active])
    off = off.reshape(len(active), len(sightings))
    free_tracks, free_boxes = set(range(len(active))), set(range(len(sightings)))
    for flat in np.argsort(off, axis=None, kind="stable"):
        row, column = divmod(int(flat), max(len(sightings), 1))
        if off[row, column] > _GATE:
            break
        if row in free_tracks and column in free_boxes:
            active[row].take(sightings[column])
            free_tracks.remove(row)
            free_boxes.remove(column)
    return [_Filter.begun(sightings[column], time_s) for column in sorted(free_boxes)]


def _first(track: Track) -> tuple[int, tuple[tuple[int, int], ...]]:
    return track.sightings[0].sweep, track.sightings[0].members


def _stitched(tracks: Sequence[Track], times: Sequence[float]) -> list[Track]:
    """Tracks that stand where an earlier one stood are its continuation."""
    done: list[Track] = []
    recent: list[int] = []
    for track in tracks:
        begins_s = times[track.sightings[0].sweep]
        # Tracks come by their first sighting: what ended too long ago for this one did for all that follow.
        recent = [n for n in recent if begins_s - times[done[n].sightings[-1].sweep] <= _LONGEST_STITCH_S]
        before = [number for number in recent if _continues(done[number], track, times)]
        if not before:
            recent.append(len(done))
            done.append(track)
            continue
        nearest = min(before, key=lambda number: _gap_m(done[number], track))
        done[nearest] = Track((*done[nearest].sightings, *track.sightings))
    return done


def _continues(before: Track, after: Track, times: Sequence[float]) -> bool:
    """Whether a track stands where one stood that ended before it."""
    last, first = before.sightings[-1], after.sightings[0]
    if last.sweep >= first.sweep:
        return False
    longer = max(last.lwh_m[0], first.lwh_m[0])
    ratio = last.lwh_m[0] / first.lwh_m[0]
    return (
        1 / _LENGTH_RATIO < ratio < _LENGTH_RATIO
        and _gap_m(before, after) < _STITCH_SHARE * longer
        and _speed_m_s(before, times) < _STANDING_M_S
        and _speed_m_s(after, times) < _STANDING_M_S
    )


def _gap_m(before: Track, after: Track) -> float:
    """Between the middles of the last boxes of one and the first of the other."""
    end = np.median([each.center_world[:2] for each in before.sightings[-5:]], axis=0)
    start = np.median([each.center_world[:2] for each in after.sightings[:5]], axis=0)
    return float(np.linalg.norm(end - start))


def _speed_m_s(track: Track, times: Sequence[float]) -> float:
    """Mean speed from the middle of its first third to that of its last; 0 for a single box."""
    third = -(-len(track.sightings) // 3)
    early, late = track.sightings[:third], track.sightings[-third:]
    elapsed = float(np.mean([times[each.sweep] for each in late]) - np.mean([times[e.sweep] for e in early]))
    if elapsed <= 0:
        return 0.0
    moved = np.median([e.center_world[:2] for e in late], 0) - np.median(
        [e.center_world[:2] for e in early], 0
    )
    return float(np.linalg.norm(moved)) / elapsed
