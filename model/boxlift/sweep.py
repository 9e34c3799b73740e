"""One LiDAR sweep and the cameras that see it: where a view belongs, and the labels of all of them.

The ego frame is the vehicle's (x forward, y left, z up, metres); in layouts that have none, such as KITTI's,
it is the LiDAR frame. `world` is whatever fixed frame the data set's poses are in.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class SweepView:
    """What one camera saw of one sweep.

    sweep: a name shared by all views of the sweep. log: the drive it belongs to, "" where there is none.
    camera: the camera's name in its data set. ego_SE3_cam: (4, 4) rectified camera frame -> ego frame at
    the sweep's time. timestamp_ns: of the sweep, where it is known. world_SE3_ego: (4, 4), where poses are.
    """

    sweep: str
    camera: str
    ego_SE3_cam: Floats
    log: str = ""
    timestamp_ns: int | None = None
    world_SE3_ego: Floats | None = None


@dataclass(frozen=True)
class CameraImage:
    """What a camera showed: ego_SE3_cam (4, 4) and projection (3, 4) of its rectified image (H, W, 3) RGB."""

    camera: str
    ego_SE3_cam: Floats
    image_P_cam: Floats
    image: NDArray[np.uint8]


@dataclass(frozen=True)
class SweepSensors:
    """What the labels of a sweep were made from: points_ego (N, 3+) and the images of its cameras."""

    points_ego: NDArray[np.float32]
    images: tuple[CameraImage, ...]


@dataclass(frozen=True)
class EgoObject:
    """A box in the ego frame.

    center_ego: (3,) geometric centre, metres. ego_SO3_object: (3, 3); the object's x runs along its length
    to the front, y along its width to the left, z up. cameras: those whose views it was labelled in.
    track_id: the same for the same object in other sweeps, where that is known. points: LiDAR points in the
    box, where they were counted. difficulty: an annotator's, as Waymo counts (1 or 2), where there is one.
    attribute: nuScenes' (vehicle.parked, pedestrian.moving, ...), where there is one.
    """

    category: str
    center_ego: Floats
    ego_SO3_object: Floats
    length_m: float
    width_m: float
    height_m: float
    score: float = 1.0
    cameras: tuple[str, ...] = ()
    flags: tuple[str, ...] = ()
    track_id: str | None = None
    points: int | None = None
    difficulty: int | None = None
    attribute: str | None = None

    @property
    def yaw_rad(self) -> float:
        """Heading about the ego frame's z axis, counter-clockwise from x, in (-pi, pi]."""
        return float(np.arctan2(self.ego_SO3_object[1, 0], self.ego_SO3_object[0, 0]))

    @property
    def caption(self) -> str:
        """What viewers show beside the box: class, track where there is one, score."""
        track = "" if self.track_id is None else f" #{self.track_id}"
        return f"{self.category}{track} {self.score:.2f}"


@dataclass(frozen=True)
class SweepLabels:
    """All objects of one sweep, in its ego frame, each once."""

    sweep: str
    objects: tuple[EgoObject, ...]
    log: str = ""
    timestamp_ns: int | None = None
    world_SE3_ego: Floats | None = None
