"""The one 3D box of the house, as a struct of arrays.

Corners, seen along -y (from above; y points down), rotation_y = 0:

          z
          ^      1 ---------- 0          4 + i is the corner above corner i
          |      |     o->    |          o is the centre, -> the heading (+x)
          +--> x 2 ---------- 3
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Calibration, Floats

_CORNER_LENGTH = np.array([1, -1, -1, 1, 1, -1, -1, 1]) / 2
_CORNER_WIDTH = np.array([1, 1, -1, -1, 1, 1, -1, -1]) / 2
_CORNER_HEIGHT = np.array([1, 1, 1, 1, -1, -1, -1, -1]) / 2

# A box that reaches behind the camera is cut here before it is projected.
NEAR_PLANE_M = 0.1


@dataclass(frozen=True)
class Boxes3D:
    """N boxes in the rectified camera frame (x right, y down, z forward), metres and radians.

    center_cam: (N, 3) geometric centres.
    length_m, width_m, height_m: (N,).
    rotation_y: (N,) about the y axis in [-pi, pi); the heading is (cos, 0, -sin) of it.
    """

    center_cam: Floats
    length_m: Floats
    width_m: Floats
    height_m: Floats
    rotation_y: Floats

    def __post_init__(self) -> None:
        center = np.asarray(self.center_cam, dtype=np.float64).reshape(-1, 3)
        object.__setattr__(self, "center_cam", center)
        for field in ("length_m", "width_m", "height_m", "rotation_y"):
            column = np.asarray(getattr(self, field), dtype=np.float64).reshape(-1)
            if column.shape != (len(center),):
                raise ValueError(f"{field} has shape {column.shape}, center_cam {center.shape}.")
            object.__setattr__(self, field, column)
        object.__setattr__(self, "rotation_y", wrap_angle(self.rotation_y))

    def __len__(self) -> int:
        return len(self.center_cam)

    def __getitem__(self, index: slice | NDArray[np.bool_] | NDArray[np.integer]) -> Boxes3D:
        return Boxes3D(
            self.center_cam[index],
            self.length_m[index],
            self.width_m[index],
            self.height_m[index],
            self.rotation_y[index],
        )

    @classmethod
    def empty(cls) -> Boxes3D:
        """No boxes."""
        none = np.empty(0)
        return cls(np.empty((0, 3)), none, none, none, none)

    @property
    def bottom_y(self) -> Floats:
        """(N,) y of the bottom faces."""
        return self.center_cam[:, 1] + self.height_m / 2

    def corners(self) -> Floats:
        """(N, 8, 3) corners in the order of the drawing above: bottom face first."""
        along = _CORNER_LENGTH * self.length_m[:, None]
        across = _CORNER_WIDTH * self.width_m[:, None]
        cos, sin = np.cos(self.rotation_y)[:, None], np.sin(self.rotation_y)[:, None]
        offsets = np.stack(
            [
                cos * along + sin * across,
                _CORNER_HEIGHT * self.height_m[:, None],
                -sin * along + cos * across,
            ],
            axis=-1,
        )
        return self.center_cam[:, None, :] + offsets

    def bev_corners(self) -> Floats:
        """(N, 4, 2) corners in the bird's-eye view as (x, z), in order around the box."""
        return self.corners()[:, :4, [0, 2]]

    def project(self, calibration: Calibration) -> Floats:
        """(N, 4) image boxes x1, y1, x2, y2 in pixels around the projected boxes, not cut to any image.

        Only the part of a box in front of the camera counts; NaN where there is none.
        """
        corners = self.corners()
        starts = corners[:, [0, 1, 2, 3, 4, 5, 6, 7, 0, 1, 2, 3]]
        ends = corners[:, [1, 2, 3, 0, 5, 6, 7, 4, 4, 5, 6, 7]]
        near = starts[..., 2].clip(NEAR_PLANE_M), ends[..., 2].clip(NEAR_PLANE_M)
        step = ends - starts
        rise = np.where(np.abs(step[..., 2]) > 1e-9, step[..., 2], 1.0)
        cut = [
            starts + step * ((z - starts[..., 2]) / rise).clip(0, 1)[..., None] for z in near
        ]  # both ends of each edge, moved along it to the near plane where they lie behind it
        pixels, _ = calibration.project(np.concatenate(cut, axis=1))
        behind = np.concatenate(cut, axis=1)[..., 2] < NEAR_PLANE_M - 1e-6
        low = np.where(behind[..., None], np.inf, pixels).min(axis=1)
        high = np.where(behind[..., None], -np.inf, pixels).max(axis=1)
        boxes_px = np.concatenate([low, high], axis=1)
        boxes_px[~np.isfinite(boxes_px).all(axis=1)] = np.nan
        return boxes_px


def wrap_angle(angle_rad: Floats) -> Floats:
    """Any angle -> [-pi, pi)."""
    wrapped: Floats = (angle_rad + np.pi) % (2 * np.pi) - np.pi
    # The remainder of a tiny negative number rounds up to the divisor itself.
    return np.where(wrapped >= np.pi, -np.pi, wrapped)


def alpha_from_rotation_y(rotation_y: Floats, center_cam: Floats) -> Floats:
    """Observation angle (N,) of boxes at center_cam (N, 3): the heading as seen along the viewing ray.

    KITTI's own labels measure the ray from the origin of the rectified frame.
    """
    return wrap_angle(rotation_y - np.arctan2(center_cam[..., 0], center_cam[..., 2]))


def rotation_y_from_alpha(alpha: Floats, center_cam: Floats) -> Floats:
    """Inverse of alpha_from_rotation_y."""
    return wrap_angle(alpha + np.arctan2(center_cam[..., 0], center_cam[..., 2]))
