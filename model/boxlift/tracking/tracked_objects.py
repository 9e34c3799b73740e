"""The objects of a drive: each with its track, its path, and the box that its frames agree on."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from boxlift.accurate.parameters import to_boxes
from boxlift.accurate.pipeline import size_pull
from boxlift.accurate.polish import SizePull
from boxlift.accurate.view import View
from boxlift.boxes import Boxes3D
from boxlift.errors import InputError, OptionsError
from boxlift.formats.details import FrameDetails, ObjectDetails
from boxlift.poses import Floats, inverse
from boxlift.priors import SizePrior
from boxlift.settings import LabellerSettings
from boxlift.tracking.drive import DriveReader, camera_pose, prompts_of
from boxlift.tracking.fused_fit import FusedBox, fit_fused, transformed
from boxlift.tracking.glimpses import Glimpse
from boxlift.tracking.linking import Track
from boxlift.tracking.paths import Motion, Path, paths_of
from boxlift.tracking.sightings import DriveSweep

# Kept of the frames that saw one object; beyond, every other is let go.
_MOST_GLIMPSES = 64
# What a box keeps of its score that no other frame confirms, and what one gets in a frame that had none.
_UNCONFIRMED, _FROM_ELSEWHERE = 0.5, 0.75
_FROZEN_SIGMA_M = 1e-3
# What the frames have to say more for a path than for a place, which is simpler.
_MOVING_COST = 4.0
# A fused box that overlaps those of the single frames by less is not theirs: they keep their own.
_LEAST_AGREEMENT = 0.2
# Of what moves, one that overlaps them by this is not asked what the frames have against it; another is, and
# loses where it is so much more than what they have against their own boxes.
_SURE_AGREEMENT, _MUCH_LIKELIER = 0.5, 4.0


@dataclass(eq=False)
class TrackedObject:
    """One object of a drive. fused is there once its frames have been looked at, and agree."""

    number: int
    track: Track
    path: Path
    fused: FusedBox | None = None

    @property
    def motion(self) -> Motion:
        """What it did."""
        return self.path.motion

    @property
    def mean_score(self) -> float:
        """Of the boxes of the single frames."""
        return float(np.mean([each.score for each in self.track.sightings]))

    @property
    def place_spread_m(self) -> float:
        """How far the middles of the single frames' boxes lie from their median, root mean square."""
        places = np.array([each.center_world[:2] for each in self.track.sightings])
        return float(np.sqrt(((places - np.median(places, axis=0)) ** 2).sum(1).mean()))

    @property
    def length_spread_m(self) -> float:
        """Standard deviation of the lengths of the single frames' boxes."""
        return float(np.std([each.lwh_m[0] for each in self.track.sightings]))

    @property
    def turned(self) -> int:
        """Boxes of single frames that look to the back, where motion tells the front."""
        if not self.path.knows_front:
            return 0
        looks = (
            self.path.world_SE3_object(each.sweep)[:2, 0]
            @ (np.cos(each.heading_rad), np.sin(each.heading_rad))
            for each in self.track.sightings
        )
        return sum(bool(look < 0) for look in looks)

    def score(self, own: float | None) -> float:
        """Confidence in the box of a frame whose own box had the score `own`; None: it had none.

        Half of it is the frame's, half that of all frames on average; benchmarks/tracking.py shows what the
        order is worth. It is no calibrated probability any more.
        """
        if len(self.track.sightings) == 1:
            return (own or 0.0) * _UNCONFIRMED
        if self.fused is None:
            return own or 0.0
        return self.mean_score * _FROM_ELSEWHERE if own is None else (self.mean_score + own) / 2

    def box_in(self, world_SE3_cam: Floats, sweep: int) -> Boxes3D | None:
        """The fused box in a camera (4, 4) at a sweep, of length 1; None where there is none."""
        if self.fused is None:
            return None
        cam_SE3_object = inverse(world_SE3_cam) @ self.path.world_SE3_object(sweep)
        return to_boxes(transformed(self.fused.parameters[None], cam_SE3_object))


@dataclass
class _Gathered:
    """What has been seen of an object so far: a sample of glimpses; of all boxes the sweep, the camera's pose
    (4, 4), the box there (7,) and its score."""

    glimpses: list[Glimpse] = field(default_factory=list)
    boxes: list[tuple[int, Floats, Floats, float]] = field(default_factory=list)
    stride: int = 1

    def add(
        self, glimpse: Glimpse | None, sweep: int, world_SE3_cam: Floats, box: Floats, score: float
    ) -> None:
        if glimpse is not None and len(self.boxes) % self.stride == 0:
            self.glimpses.append(glimpse)
        self.boxes.append((sweep, world_SE3_cam, box, score))
        if len(self.glimpses) > _MOST_GLIMPSES:
            self.glimpses = self.glimpses[::2]
            self.stride *= 2

    def boxes_along(self, path: Path) -> Floats:
        """(S, 7) the boxes in the object's frame."""
        return np.concatenate(
            [
                transformed(box[None], inverse(path.world_SE3_object(sweep)) @ world_SE3_cam)
                for sweep, world_SE3_cam, box, _ in self.boxes
            ]
        )


def tracked_objects(
    sweeps: Sequence[DriveSweep], tracks: Sequence[Track], reader: DriveReader, settings: LabellerSettings
) -> list[TrackedObject]:
    """The objects of all tracks, numbered from 1, fitted to what their frames saw.

    Reads every frame once and holds what was seen of an object until its last sighting. Raises
    LabelFormatError, OSError; frames that cannot be loaded show nothing.
    """
    paths = [paths_of(track, sweeps) for track in tracks]
    objects = [TrackedObject(row + 1, track, paths[row][0]) for row, track in enumerate(tracks)]
    members: defaultdict[int, list[tuple[int, int, int]]] = defaultdict(list)
    for row, each in enumerate(objects):
        for sighting in each.track.sightings:
            members[sighting.sweep] += [(view, item, row) for view, item in sighting.members]
    gathered: defaultdict[int, _Gathered] = defaultdict(_Gathered)
    for sweep in sweeps:
        for view, details, seen in _views(sweep, members[sweep.number], reader, settings):
            for item, row in seen:
                _gather(gathered[row], objects[row], sweep, view, details, item, settings)
        ended = [row for row in list(gathered) if objects[row].track.sightings[-1].sweep <= sweep.number]
        for row in ended:
            _fuse(objects[row], paths[row], gathered.pop(row), settings)
    return objects


def _views(
    sweep: DriveSweep,
    members: Sequence[tuple[int, int, int]],
    reader: DriveReader,
    settings: LabellerSettings,
) -> Iterator[tuple[View | None, FrameDetails, list[tuple[int, int]]]]:
    """Every frame of a sweep that has boxes: what it saw, its details, and (item, row) of the boxes."""
    for number, name in enumerate(sweep.frames):
        seen = [(item, row) for view, item, row in members if view == number]
        if not seen:
            continue
        details = reader.details(name)
        try:
            view = View.of(reader.load(name, prompts_of(details)), settings.ground)
        except InputError:
            view = None
        yield view, details, seen


def _gather(
    gathered: _Gathered,
    tracked: TrackedObject,
    sweep: DriveSweep,
    view: View | None,
    details: FrameDetails,
    item: int,
    settings: LabellerSettings,
) -> None:
    labelled = details.objects[item]
    world_SE3_cam = camera_pose(sweep, details)
    own = _parameters(labelled)
    glimpse = None
    # A single box is all there is to know.
    if view is not None and len(tracked.track.sightings) > 1:
        height_m = _prior(labelled.category, settings).height_m
        glimpse = Glimpse.of(view, item, sweep.number, world_SE3_cam, height_m, own)
        glimpse = glimpse if len(glimpse.region.inside) else None
    gathered.add(glimpse, sweep.number, world_SE3_cam, own, labelled.score)


def _parameters(labelled: ObjectDetails) -> Floats:
    box = labelled.box
    assert box is not None, labelled.index
    x, y, z = box.center_cam
    size = box.length_m, box.width_m, box.height_m
    return np.array([x, z, box.rotation_y, *size, y + box.height_m / 2])


def _fuse(
    tracked: TrackedObject, paths: Sequence[Path], gathered: _Gathered, settings: LabellerSettings
) -> None:
    """Fit the object's box along its path; where two are in doubt, along that which its frames speak for."""
    if not gathered.glimpses:
        return
    scores = np.array([score for *_, score in gathered.boxes])
    size = _size_pull(tracked.track.category, settings)
    fits = []
    for path in paths:
        boxes = gathered.boxes_along(path)
        fits.append((fit_fused(gathered.glimpses, path, boxes, scores, size, settings), path))
    fused, path = min(fits, key=lambda fit: fit[0].cost + _MOVING_COST * (not fit[1].stands))
    if fused.agreement >= _LEAST_AGREEMENT and (path.stands or _holds_together(fused)):
        tracked.path, tracked.fused = path, fused


def _holds_together(fused: FusedBox) -> bool:
    """Whether a path was good enough to fuse frames along it: the frames' own boxes are not much likelier."""
    if fused.agreement >= _SURE_AGREEMENT:
        return True
    return (
        fused.energy is not None
        and fused.own_energy is not None
        and fused.energy - fused.own_energy < _MUCH_LIKELIER
    )


def _size_pull(category: str, settings: LabellerSettings) -> SizePull:
    """Sizes that single frames did not refine stay frozen."""
    prior = _prior(category, settings)
    if settings.repairs is not None and settings.repairs.size == "refined":
        return size_pull(prior)
    frozen = np.array([prior.length_m, prior.width_m, prior.height_m])
    return SizePull(frozen, np.full(3, _FROZEN_SIGMA_M))


def _prior(category: str, settings: LabellerSettings) -> SizePrior:
    try:
        return settings.sizes[category]
    except KeyError:
        raise OptionsError(
            "class",
            f"{category!r} has no size among those that the labels were made with.",
            "Label the frames again with --priors that have it.",
        ) from None
