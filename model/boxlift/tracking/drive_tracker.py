"""The frames of a drive, labelled one by one, in; the same frames with what the drive knows, out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from boxlift.formats.details import FrameDetails
from boxlift.settings import LabellerSettings
from boxlift.tracking.drive import DriveReader, Poses, SweepFrames, survey
from boxlift.tracking.frame_pass import Fill, rewritten_frames
from boxlift.tracking.linking import link
from boxlift.tracking.tracked_objects import TrackedObject, tracked_objects


class DriveTracker:
    """Tracks the objects of drives, as their boxes were labelled with `settings`.

    poses: from the data set as they are, or matched: found by matching sweeps, near the data set's where it
    has any. fill: which frames without a prompt get a box. objects: those of the last drive.
    """

    def __init__(self, settings: LabellerSettings, poses: Poses = "matched", fill: Fill = "gaps") -> None:
        self._settings = settings
        self._poses: Poses = poses
        self._fill: Fill = fill
        self.objects: list[TrackedObject] = []

    def track(self, sweeps: Sequence[SweepFrames], reader: DriveReader) -> Iterator[FrameDetails]:
        """The details of every frame, sweep by sweep.

        Three times over the frames, none of which holds more than the objects in view: where sweeps were
        taken and which boxes are one object; what the frames of each object saw, from which its box is
        fitted; and the frames again, with the boxes in them. Raises LabelFormatError, OSError, and
        MissingExtraError where sweeps are to be matched and KISS-ICP is not there. Frames that cannot be
        loaded keep what they have.
        """
        drive = survey(sweeps, reader, self._poses)
        times = (sweep.time_s for sweep in drive.sweeps)
        tracks = link(zip(times, drive.sightings, strict=True))
        self.objects = tracked_objects(drive.sweeps, tracks, reader, self._settings)
        yield from rewritten_frames(drive.sweeps, self.objects, reader, self._settings, self._fill)
