"""A drive as it is read: its sweeps, where and when they were taken, and the boxes of each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import tee
from typing import Literal, Protocol

import numpy as np

from boxlift.errors import DatasetError, InputError
from boxlift.formats.details import FrameDetails
from boxlift.frame import Frame, Prompt
from boxlift.poses import Floats
from boxlift.tracking.odometry import UnmatchedSweep, matched_poses
from boxlift.tracking.sightings import SWEEP_PERIOD_S, DriveSweep, Sighting, sightings_of, up_of

Poses = Literal["matched", "dataset"]


class DriveReader(Protocol):
    """How the frames of a drive are read, again and again."""

    def details(self, name: str) -> FrameDetails:
        """What one frame's labels say. Raises LabelFormatError, OSError."""

    def load(self, name: str, prompts: tuple[Prompt, ...]) -> Frame:
        """The frame, without its image. Raises InputError."""


@dataclass(frozen=True)
class SweepFrames:
    """The frames of one sweep by name, and its time where it is known."""

    frames: tuple[str, ...]
    timestamp_ns: int | None = None


@dataclass(frozen=True)
class Survey:
    """The sweeps of a drive, and the boxes of each."""

    sweeps: tuple[DriveSweep, ...]
    sightings: tuple[tuple[Sighting, ...], ...]


def survey(given: Sequence[SweepFrames], reader: DriveReader, poses: Poses) -> Survey:
    """Read a drive once. What cannot be loaded is passed over.

    Raises LabelFormatError, OSError, DatasetError where the data set's poses are asked for and it has none,
    and MissingExtraError where sweeps are to be matched and KISS-ICP is not there.
    """
    start_ns = next((each.timestamp_ns for each in given if each.timestamp_ns is not None), 0)
    sweeps: list[DriveSweep] = []
    sightings: list[tuple[Sighting, ...]] = []
    # Matching looks a few sweeps ahead of what is made of them.
    ahead, read = tee([reader.details(name) for name in each.frames] for each in given)
    found = (
        matched_poses(_unmatched(frames, reader) for frames in ahead) if poses == "matched" else _told(ahead)
    )
    for number, (each, frames, world_SE3_ego) in enumerate(zip(given, read, found, strict=True)):
        known_ns = each.timestamp_ns
        time_s = number * SWEEP_PERIOD_S if known_ns is None else (known_ns - start_ns) / 1e9
        time_s = max(time_s, sweeps[-1].time_s) if sweeps else time_s  # where only some have times
        sweeps.append(DriveSweep(number, time_s, world_SE3_ego, up_of(frames, world_SE3_ego), each.frames))
        sightings.append(tuple(sightings_of(number, frames, world_SE3_ego)))
    return Survey(tuple(sweeps), tuple(sightings))


def _told(sweeps: Iterable[Sequence[FrameDetails]]) -> Iterator[Floats]:
    """The data set's poses; a sweep without LiDAR is where the one before it was."""
    pose = np.eye(4)
    for frames in sweeps:
        told = _told_pose(frames)
        if told is None and any(frame.view is not None for frame in frames):
            raise DatasetError(
                frames[0].frame, "the data set has no pose of this sweep.", "Leave --poses dataset out."
            )
        pose = pose if told is None else told
        yield pose


def _told_pose(frames: Sequence[FrameDetails]) -> Floats | None:
    matrices = (frame.view.world_SE3_ego for frame in frames if frame.view is not None)
    return next((np.array(matrix) for matrix in matrices if matrix is not None), None)


def _unmatched(frames: Sequence[FrameDetails], reader: DriveReader) -> UnmatchedSweep:
    """A sweep's points by the first of its frames that can be loaded; none where none can."""
    told = _told_pose(frames)
    for details in frames:
        if details.view is None:
            continue
        try:
            frame = reader.load(details.frame, ())
        except InputError:
            continue
        ego_SE3_velo = np.array(details.view.ego_SE3_cam) @ frame.calibration.cam_SE3_velo
        points_ego = frame.points_velo[:, :3] @ ego_SE3_velo[:3, :3].T + ego_SE3_velo[:3, 3]
        x, y, z = (float(value) for value in -np.array(details.view.ego_SE3_cam)[:3, 1])
        return UnmatchedSweep(points_ego, told, (x, y, z))
    return UnmatchedSweep(np.empty((0, 3)), told)


def prompts_of(details: FrameDetails) -> tuple[Prompt, ...]:
    """The prompts that a frame was labelled from."""
    return tuple(Prompt(each.category, each.prompt_box_px, each.prompt_score) for each in details.objects)


def camera_pose(sweep: DriveSweep, details: FrameDetails) -> Floats:
    """world_SE3_cam (4, 4) of a frame that has a view."""
    assert details.view is not None, details.frame
    world_SE3_cam: Floats = sweep.world_SE3_ego @ np.array(details.view.ego_SE3_cam)
    return world_SE3_cam
