"""The details of a frame, rewritten with what its drive says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from boxlift.boxes import Boxes3D
from boxlift.formats.changed_details import object_without_prompt, with_box, with_own_box
from boxlift.formats.details import FrameDetails, ObjectDetails, PointDetails, TrackDetails
from boxlift.frame import LossTerms, Result
from boxlift.tracking.paths import Motion

# A reviewer's flags that a drive adds.
SINGLE_SIGHTING = "single_sighting"
NOT_SEEN_HERE = "box_from_other_frames"
_FEW_POINTS = 30


@dataclass(frozen=True)
class TrackedBox:
    """The box of a track in one frame.

    box: of length 1, in the frame's camera; None to keep the frame's own. points, losses: of the fused box,
    over all frames. from_elsewhere: whether the frame itself had no box for it.
    """

    track: int
    motion: Motion
    sightings: int
    category: str
    score: float
    box: Boxes3D | None = None
    knows_front: bool = False
    shows_size: bool = False
    points: int = 0
    losses: LossTerms | None = None
    from_elsewhere: bool = False

    @property
    def details(self) -> TrackDetails:
        """As they are written."""
        return TrackDetails(id=self.track, motion=str(self.motion), sightings=self.sightings)


@dataclass(frozen=True)
class FilledBox:
    """A box where the frame had no prompt: outline_px (4,) of the box, cut to the image; points on it."""

    tracked: TrackedBox
    box: Boxes3D
    outline_px: tuple[float, float, float, float]
    points: int


def relabelled(
    frame: FrameDetails, boxes: Mapping[int, TrackedBox], filled: Sequence[FilledBox]
) -> FrameDetails:
    """A frame's details with the boxes of tracks, by number of the object, and those it had no prompt for."""
    objects = [
        _rewritten(each, boxes[row]) if row in boxes else each for row, each in enumerate(frame.objects)
    ]
    objects += [_appended(len(objects) + number, each) for number, each in enumerate(filled)]
    return frame.model_copy(update={"objects": tuple(objects)})


def _rewritten(item: ObjectDetails, tracked: TrackedBox) -> ObjectDetails:
    flags = _flags(item.flags, tracked)
    if tracked.box is None:
        return with_own_box(item, tracked.score, flags, tracked.details)
    result = Result.TRACKED if tracked.from_elsewhere else Result.FITTED
    return _with_box(item, tracked, tracked.box, flags, result)


def _with_box(
    item: ObjectDetails, tracked: TrackedBox, box: Boxes3D, flags: tuple[str, ...], result: Result
) -> ObjectDetails:
    return with_box(
        item, tracked.category, box, tracked.score, flags, tracked.details, result, tracked.losses
    )


def _flags(flags: Sequence[str], tracked: TrackedBox) -> tuple[str, ...]:
    """What the drive knows better is said no more."""
    settled = set()
    if tracked.knows_front:
        settled.add("heading_ambiguous")
    if tracked.shows_size:
        settled.add("size_from_prior")
    if tracked.points >= _FEW_POINTS:
        settled.add("few_points")
    kept = [flag for flag in flags if flag not in settled]
    if tracked.from_elsewhere:
        kept.append(NOT_SEEN_HERE)
    if tracked.sightings == 1:
        kept.append(SINGLE_SIGHTING)
    return tuple(kept)


def _appended(index: int, filled: FilledBox) -> ObjectDetails:
    tracked = filled.tracked
    flags = ["heading_ambiguous", "size_from_prior", *(["few_points"] if filled.points < _FEW_POINTS else [])]
    item = object_without_prompt(
        index,
        tracked.category,
        filled.outline_px,
        PointDetails(in_prompt=0, above_ground=0, in_cluster=filled.points, used=0),
    )
    return _with_box(item, tracked, filled.box, _flags(flags, tracked), Result.FILLED)
