"""The ground plane, by RANSAC (paper, section 3.1 'Object-LiDAR-points')."""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Floats
from boxlift.extras import open3d
from boxlift.ground_surface import GroundSurface, fit_surface
from boxlift.seeds import seed_of
from boxlift.settings import GroundSettings

# Open3D draws RANSAC samples from one generator per process.
_OPEN3D_RANDOM = threading.Lock()
# A plane has three unknowns; more points than this only cost time.
_ENOUGH_POINTS = 5000
# Walls can hold more points than the road; this many larger planes are set aside before giving up.
_MAX_WALLS = 3


@dataclass(frozen=True)
class GroundPlane:
    """Points p with up . p + offset = 0, rectified camera frame; `up` (3,) is the unit normal upwards."""

    up: Floats
    offset_m: float

    def height_above(self, points_cam: NDArray[np.floating]) -> Floats:
        """(N, 3) points -> (N,) signed heights above the plane, metres."""
        heights: Floats = points_cam @ self.up + self.offset_m
        return heights


# Where no ground is found the camera stands this far above it: that of a passenger car (ours).
_CAMERA_HEIGHT_M = 1.65


@dataclass(frozen=True)
class Ground:
    """Which of the points (N,) are ground; the plane and the surface above it, where they were found."""

    is_ground: NDArray[np.bool_]
    plane: GroundPlane | None
    surface: GroundSurface | None = None

    @property
    def found(self) -> bool:
        """Whether there is a plane."""
        return self.plane is not None

    def height_above(self, points_cam: Floats) -> Floats:
        """(N, 3) points -> (N,) heights above the ground, metres."""
        heights = (self.plane or _LEVEL).height_above(points_cam)
        if self.surface is not None:
            heights = heights - self.surface.height_at(points_cam[:, 0], points_cam[:, 2])
        return heights

    def y_at(self, x: Floats, z: Floats) -> Floats:
        """(N,) y of the ground at x, z (N,)."""
        plane = self.plane or _LEVEL
        above = 0.0 if self.surface is None else self.surface.height_at(x, z)
        y: Floats = (above - plane.offset_m - plane.up[0] * x - plane.up[2] * z) / plane.up[1]
        return y

    def is_known(self, x: Floats, z: Floats) -> NDArray[np.bool_]:
        """(N,) whether ground was seen around x, z."""
        if self.surface is None:
            return np.full(x.shape, self.found)
        return self.surface.is_known(x, z)


_LEVEL = GroundPlane(np.array([0.0, -1.0, 0.0]), _CAMERA_HEIGHT_M)


def find_ground(points_cam: Floats, frame_name: str, settings: GroundSettings) -> Ground:
    """Tell ground among the (N, 3) points of a frame; none of them where there is no plane or no wish."""
    plane = fit_plane(points_cam, settings, seed_of(frame_name)) if settings.remove else None
    if plane is None:
        return Ground(np.zeros(len(points_cam), dtype=np.bool_), None)
    above_m = plane.height_above(points_cam)
    surface = fit_surface(points_cam, above_m, settings) if settings.shape == "surface" else None
    ground = Ground(np.empty(0, dtype=np.bool_), plane, surface)
    return replace(ground, is_ground=ground.height_above(points_cam) < settings.inlier_distance_m)


def fit_plane(points_cam: Floats, settings: GroundSettings, seed: int) -> GroundPlane | None:
    """The largest plane among (N, 3) points that lies flat; None where there is none.

    Walls are set aside: a plane that leans more than `max_tilt_deg` from the camera's horizontal.
    The camera's y axis is taken as roughly vertical.
    """
    o3d = open3d()
    points_cam = points_cam[:: max(1, len(points_cam) // _ENOUGH_POINTS)]
    flat = np.cos(np.deg2rad(settings.max_tilt_deg))
    rest = points_cam
    for _ in range(_MAX_WALLS + 1):
        if len(rest) < 3:
            return None
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(rest))
        with _OPEN3D_RANDOM:
            o3d.utility.random.seed(seed)
            # probability=1 switches off the early stop, whose moment depends on the number of threads.
            plane, inliers = cloud.segment_plane(
                settings.inlier_distance_m, ransac_n=3, num_iterations=settings.iterations, probability=1.0
            )
        normal = np.asarray(plane[:3])
        length = float(np.linalg.norm(normal))
        if not length > 0:
            return None
        sign = -1.0 if normal[1] > 0 else 1.0  # up is -y
        up, offset_m = sign * normal / length, sign * float(plane[3]) / length
        if -up[1] >= flat:
            return GroundPlane(up, offset_m)
        rest = np.delete(rest, np.asarray(inliers, dtype=np.intp), axis=0)
    return None
