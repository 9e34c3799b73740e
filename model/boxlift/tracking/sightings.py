"""What the frames of a drive say, sweep by sweep, each for itself: where, when, and which boxes.

The world is the fixed frame of the poses, z roughly up. Boxes that several cameras saw are one sighting.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from boxlift.formats.details import FrameDetails
from boxlift.formats.ego_boxes import sweep_labels_of_details
from boxlift.merging import same_objects
from boxlift.poses import Floats

# Where a data set has no times its sweeps are taken for as far apart as those of most LiDARs.
SWEEP_PERIOD_S = 0.1
_UPRIGHT = 1.2


@dataclass(frozen=True, slots=True)
class DriveSweep:
    """One sweep of a drive: the n-th, when and where it was taken, and its frames by name.

    world_SE3_ego: (4, 4). up_world: (3,) the vertical of its cameras, in which boxes stand upright.
    """

    number: int
    time_s: float
    world_SE3_ego: Floats
    up_world: Floats
    frames: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Sighting:
    """One box of one sweep.

    sweep: its number. members: (number of the frame within the sweep, number of the object within its frame)
    of every view that has the box. center_world: (3,). heading_rad: about the world's z, from x; front and
    back are not told apart. range_m: from the ego frame's origin. is_cut: by the image's border.
    """

    sweep: int
    members: tuple[tuple[int, int], ...]
    category: str
    score: float
    center_world: Floats
    heading_rad: float
    lwh_m: tuple[float, float, float]
    range_m: float
    is_cut: bool = False

    @property
    def sigma_m(self) -> float:
        """How far its centre may be off (ours): far, doubtful and cut boxes farther."""
        return 0.25 + 0.01 * self.range_m + 0.5 * (1 - self.score) + 1.0 * self.is_cut

    @property
    def is_upright(self) -> bool:
        """Whether it is taller than long, as people are."""
        return self.lwh_m[2] > _UPRIGHT * self.lwh_m[0]


def up_of(frames: Sequence[FrameDetails], world_SE3_ego: Floats) -> Floats:
    """(3,) the mean vertical of a sweep's cameras in the world."""
    ups = [
        -np.array(frame.view.ego_SE3_cam)[:3, 1] for frame in frames if frame.view is not None
    ]  # a rectified camera's y points down
    up = world_SE3_ego[:3, :3] @ np.mean(ups, axis=0) if ups else np.array([0.0, 0.0, 1.0])
    up_world: Floats = up / max(float(np.linalg.norm(up)), 1e-9)
    return up_world


def sightings_of(number: int, frames: Sequence[FrameDetails], world_SE3_ego: Floats) -> list[Sighting]:
    """The boxes of a sweep from the details of its frames; what several cameras saw is there once."""
    views = [sweep_labels_of_details(frame) for frame in frames]
    # sweep_labels_of_details leaves out what has no box.
    rows = [[row for row, each in enumerate(frame.objects) if each.box is not None] for frame in frames]
    sightings = []
    for group in same_objects(views):
        boxes = [views[view].objects[index] for view, index in group]
        best = max(boxes, key=lambda box: box.score)
        heading = world_SE3_ego[:3, :3] @ best.ego_SO3_object[:, 0]
        sightings.append(
            Sighting(
                sweep=number,
                members=tuple((view, rows[view][index]) for view, index in group),
                category=best.category,
                score=best.score,
                center_world=world_SE3_ego[:3, :3] @ best.center_ego + world_SE3_ego[:3, 3],
                heading_rad=float(np.arctan2(heading[1], heading[0])),
                lwh_m=(best.length_m, best.width_m, best.height_m),
                range_m=float(np.linalg.norm(best.center_ego)),
                is_cut="truncated" in best.flags,
            )
        )
    return sightings
