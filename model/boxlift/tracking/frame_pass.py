"""The frames of a drive once more: the boxes of its objects put into each, also where it had none itself.

An object that other frames show is looked for wherever it would be in view. Where a prompt is without a box,
or has one that no other frame confirms, and the object's outline covers it, the prompt was the object's.
Where there is no prompt, points have to lie on the box: nothing may hide it, and few rays go through it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from boxlift.accurate.view import View
from boxlift.boxes import Boxes3D
from boxlift.camera import Floats
from boxlift.errors import InputError
from boxlift.formats.details import FrameDetails, boxes3d_of_details
from boxlift.frame import Frame
from boxlift.overlap import bev_intersection, iou_2d
from boxlift.settings import LabellerSettings
from boxlift.tracking.drive import DriveReader, camera_pose, prompts_of
from boxlift.tracking.relabel import FilledBox, TrackedBox, relabelled
from boxlift.tracking.sightings import DriveSweep
from boxlift.tracking.tracked_objects import TrackedObject

# Which frames without a prompt get a box: none, those between an object's sightings, or all that it is in
# view of.
Fill = Literal["none", "gaps", "view"]

# Objects of so many sightings and such a mean score are looked for in other frames; standing ones this long
# before and after they were seen.
_FEWEST_SIGHTINGS, _LEAST_SCORE = 3, 0.35
_LOOK_AROUND_S = 5.0
# A track of no more sightings than this confirms nothing: its prompts may be another's.
_UNCONFIRMED = 2
_COVERS = 0.5
_NEAREST_M, _FARTHEST_M = 1.0, 80.0
# The part of the outline that has to be within the image.
_IN_IMAGE = 0.3
# So many points lie on a box, and of the rays to its middle this share ends there.
_FEWEST_POINTS, _LEAST_ON = 3, 0.4
_MIDDLE = 0.6
_OFF_GROUND_M, _ON_M = 0.2, 0.15
# A box that shares more than this of the smaller one's area with another stands where that does.
_MAY_OVERLAP = 0.1


@dataclass(frozen=True)
class _Visible:
    """An object where it would be in a frame: its box and outline (4,) px, cut to the image.

    in_view: whether its middle and enough of it are in the image to put a box where no prompt is.
    """

    tracked: TrackedObject
    box: Boxes3D
    outline_px: Floats
    in_view: bool


def rewritten_frames(
    sweeps: Sequence[DriveSweep],
    objects: Sequence[TrackedObject],
    reader: DriveReader,
    settings: LabellerSettings,
    fill: Fill,
) -> Iterator[FrameDetails]:
    """The details of all frames, sweep by sweep. Raises LabelFormatError, OSError."""
    by_sweep: defaultdict[int, dict[tuple[int, int], TrackedObject]] = defaultdict(dict)
    for each in objects:
        for sighting in each.track.sightings:
            for member in sighting.members:
                by_sweep[sighting.sweep][member] = each
    times = np.array([sweep.time_s for sweep in sweeps])
    comes: defaultdict[int, list[tuple[int, TrackedObject]]] = defaultdict(list)
    for each in objects:
        if _is_sure(each):
            first, last = _known_from_to(each, times)
            comes[first].append((last, each))
    there: list[tuple[int, TrackedObject]] = []
    for sweep in sweeps:
        there = [(last, each) for last, each in there if last >= sweep.number] + comes[sweep.number]
        alive = sorted((each for _, each in there), key=lambda each: each.number)
        for number, name in enumerate(sweep.frames):
            details = reader.details(name)
            own = {item: each for (view, item), each in by_sweep[sweep.number].items() if view == number}
            missing = [each for each in alive if each not in own.values()]
            filling = [
                each for each in missing if fill == "view" or (fill == "gaps" and _is_gap(each, sweep))
            ]
            yield _rewritten(sweep, details, own, missing, filling, reader, settings)


def _is_sure(tracked: TrackedObject) -> bool:
    return (
        tracked.fused is not None
        and len(tracked.track.sightings) >= _FEWEST_SIGHTINGS
        and tracked.mean_score >= _LEAST_SCORE
    )


def _known_from_to(tracked: TrackedObject, times: Floats) -> tuple[int, int]:
    """The first and the last sweep at which its place is known; times: (K,) of all sweeps, ascending."""
    first, last = (tracked.track.sightings[end].sweep for end in (0, -1))
    if not tracked.path.stands:
        return first, last
    return (
        int(np.searchsorted(times, times[first] - _LOOK_AROUND_S, "left")),
        int(np.searchsorted(times, times[last] + _LOOK_AROUND_S, "right")) - 1,
    )


def _is_gap(tracked: TrackedObject, sweep: DriveSweep) -> bool:
    """Whether it was seen both before and after."""
    sightings = tracked.track.sightings
    return sightings[0].sweep < sweep.number < sightings[-1].sweep


def _rewritten(
    sweep: DriveSweep,
    details: FrameDetails,
    own: dict[int, TrackedObject],
    missing: Sequence[TrackedObject],
    filling: Sequence[TrackedObject],
    reader: DriveReader,
    settings: LabellerSettings,
) -> FrameDetails:
    """own: by number of the object in the frame. missing: who may have a prompt; filling: who needs none."""
    if details.view is None:
        return details
    world_SE3_cam = camera_pose(sweep, details)
    boxes = {
        item: _tracked_box(each, each.box_in(world_SE3_cam, sweep.number), details.objects[item].score)
        for item, each in own.items()
    }
    try:
        frame = reader.load(details.frame, prompts_of(details))
    except InputError:
        return relabelled(details, boxes, ())
    visible = [
        seen
        for each in missing
        if (seen := _visible(each, each.box_in(world_SE3_cam, sweep.number), frame)) is not None
    ]
    rest = []
    for seen, item in _prompts_for(visible, details, own):
        if item is None:
            rest += [seen] if seen.in_view and seen.tracked in filling else []
        else:
            boxes[item] = _tracked_box(seen.tracked, seen.box, None)
    filled = _filled(rest, frame, details, boxes, settings) if rest else []
    return relabelled(details, boxes, filled)


def _visible(tracked: TrackedObject, box: Boxes3D | None, frame: Frame) -> _Visible | None:
    """None where it is not before the camera, too far away, or wholly beyond the image's border."""
    if box is None:
        return None
    center = box.center_cam
    pixels, depth_m = frame.calibration.project(center)
    outline = box.project(frame.calibration)[0]
    if not depth_m[0] < _FARTHEST_M or np.isnan(outline).any():
        return None
    width, height = frame.image_size_px
    cut = outline.clip(0, np.array([width, height, width, height]) - 1.0)
    sides = cut[2:] - cut[:2]
    if (sides < 1).any():
        return None
    share = float(np.prod(sides)) / max(float(np.prod(outline[2:] - outline[:2])), 1e-9)
    inside = (pixels[0] >= 0) & (pixels[0] < (width, height))  # NaN is not
    in_view = bool(inside.all()) and share > _IN_IMAGE and depth_m[0] > _NEAREST_M
    return _Visible(tracked, box, cut, in_view)


def _prompts_for(
    visible: Sequence[_Visible], details: FrameDetails, own: dict[int, TrackedObject]
) -> list[tuple[_Visible, int | None]]:
    """The prompt of each object, of those that nobody else confirms; None where it has none."""
    free = [
        item
        for item in range(len(details.objects))
        if item not in own or len(own[item].track.sightings) <= _UNCONFIRMED
    ]
    prompts_px = np.array([details.objects[item].prompt_box_px for item in free]).reshape(-1, 4)
    pairs = []
    for row, seen in enumerate(visible):
        overlap = iou_2d(np.broadcast_to(seen.outline_px, prompts_px.shape), prompts_px)
        pairs += [(-float(iou), row, item) for iou, item in zip(overlap, free, strict=True) if iou > _COVERS]
    item_of: dict[int, int] = {}
    for _, row, item in sorted(pairs):
        if row not in item_of and item not in item_of.values():
            item_of[row] = item
    return [(seen, item_of.get(row)) for row, seen in enumerate(visible)]


def _filled(
    visible: Sequence[_Visible],
    frame: Frame,
    details: FrameDetails,
    boxes: dict[int, TrackedBox],
    settings: LabellerSettings,
) -> list[FilledBox]:
    """The objects that points lie on, where no other box stands; the surest first."""
    view = View.of(frame, settings.ground)
    standing = [_box_of(details, item, boxes) for item in range(len(details.objects))]
    taken = [box for box in standing if box is not None]
    filled = []
    for seen in sorted(visible, key=lambda each: -each.tracked.mean_score):
        points = _points_on(view, seen)
        if points is None or any(_overlap(seen.box, other) > _MAY_OVERLAP for other in taken):
            continue
        taken.append(seen.box)
        x1, y1, x2, y2 = (float(edge) for edge in seen.outline_px)
        filled.append(FilledBox(_tracked_box(seen.tracked, None, None), seen.box, (x1, y1, x2, y2), points))
    return filled


def _box_of(details: FrameDetails, item: int, boxes: dict[int, TrackedBox]) -> Boxes3D | None:
    tracked = boxes.get(item)
    if tracked is not None and tracked.box is not None:
        return tracked.box
    box = details.objects[item].box
    return None if box is None else boxes3d_of_details([box])


def _overlap(a: Boxes3D, b: Boxes3D) -> float:
    """Shared area as a share of the smaller box's."""
    smaller = min(float(each.length_m[0] * each.width_m[0]) for each in (a, b))
    return float(bev_intersection(a, b)[0]) / max(smaller, 1e-9)


def _points_on(view: View, seen: _Visible) -> int | None:
    """Points on a box; None if they are too few, or too many rays to its middle end elsewhere."""
    box = seen.box
    offset = view.points_cam - box.center_cam[0]
    cos, sin = float(np.cos(box.rotation_y[0])), float(np.sin(box.rotation_y[0]))
    along, across = cos * offset[:, 0] - sin * offset[:, 2], sin * offset[:, 0] + cos * offset[:, 2]
    off_ground = view.above_m > _OFF_GROUND_M
    on = (
        off_ground
        & (np.abs(along) < box.length_m[0] / 2 + _ON_M)
        & (np.abs(across) < box.width_m[0] / 2 + _ON_M)
        & (np.abs(offset[:, 1]) < box.height_m[0] / 2 + _ON_M)
    )
    low_px, high_px = seen.outline_px[:2], seen.outline_px[2:]
    middle, reach = (low_px + high_px) / 2, (high_px - low_px) * _MIDDLE / 2
    rays = off_ground & view.within(middle - reach, middle + reach)
    enough = on.sum() >= _FEWEST_POINTS and (on & rays).sum() >= _LEAST_ON * rays.sum()
    return int(on.sum()) if enough else None


def _tracked_box(tracked: TrackedObject, box: Boxes3D | None, own_score: float | None) -> TrackedBox:
    """own_score: of the frame's own box; None where it had none."""
    fused = tracked.fused
    return TrackedBox(
        track=tracked.number,
        motion=tracked.motion,
        sightings=len(tracked.track.sightings),
        category=tracked.track.category,
        score=tracked.score(own_score),
        box=box,
        knows_front=tracked.path.knows_front,
        shows_size=fused is not None and fused.shows_size,
        points=0 if fused is None else fused.points,
        losses=None if fused is None else fused.losses,
        from_elsewhere=own_score is None,
    )
