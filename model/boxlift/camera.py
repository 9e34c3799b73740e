"""Calibration: the one place that knows how LiDAR, rectified camera and image map to each other.

Frames: `velo` is the LiDAR's (x forward, y left, z up), `cam` the rectified camera frame
(x right, y down, z forward), both in metres; `px` are pixels, (0, 0) the centre of the top left one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxlift.errors import CalibrationError

Floats = NDArray[np.float64]

# Beyond this condition number an inverse has lost all the digits of a calibration file.
_SINGULAR_CONDITION = 1e10
# How far rotations may be from orthonormal, and z from the optical axis: files with two decimals pass.
_LARGEST_SKEW = 0.02
# Far beyond any vehicle and any lens.
_LARGEST_OFFSET_M = 1000.0
_LARGEST_PIXELS = 1e8


@dataclass(frozen=True)
class Calibration:
    """One camera and one LiDAR.

    image_P_cam: (3, 4) projection of the rectified camera frame to pixels (KITTI's P2).
    cam_SE3_velo: (4, 4) LiDAR frame to rectified camera frame (KITTI's R0_rect @ Tr_velo_to_cam).

    Raises CalibrationError where a matrix has the wrong shape, is not finite, is singular, or is no camera
    or no rigid transform.
    """

    image_P_cam: Floats
    cam_SE3_velo: Floats

    def __post_init__(self) -> None:
        for field, shape in (("image_P_cam", (3, 4)), ("cam_SE3_velo", (4, 4))):
            matrix = _finite_matrix(field, getattr(self, field), shape)
            matrix.setflags(write=False)
            object.__setattr__(self, field, matrix)
        for field, square in (
            ("image_P_cam", self.image_P_cam[:, :3]),
            ("cam_SE3_velo", self.cam_SE3_velo[:3, :3]),
        ):
            if not np.linalg.cond(square) < _SINGULAR_CONDITION:
                raise CalibrationError(
                    field, f"the matrix {square.tolist()} is singular.", "Give one that can be inverted."
                )
        # A projection means the same at any scale; at this one its third row gives depth in metres.
        scaled = self.image_P_cam / np.linalg.norm(self.image_P_cam[2, :3])
        scaled.setflags(write=False)
        object.__setattr__(self, "image_P_cam", scaled)
        self._require_physical()

    @property
    def focal_px(self) -> tuple[float, float]:
        """Focal lengths (f_x, f_y) in pixels."""
        return float(self.image_P_cam[0, 0]), float(self.image_P_cam[1, 1])

    @property
    def camera_center_cam(self) -> Floats:
        """(3,) optical centre of the camera in the rectified frame: where P sends everything to zero.

        KITTI's P2 belongs to the left colour camera, 6 cm beside the origin of the rectified frame.
        """
        return np.float64(-1) * np.linalg.solve(self.image_P_cam[:, :3], self.image_P_cam[:, 3])

    @property
    def lidar_center_cam(self) -> Floats:
        """(3,) origin of the LiDAR in the rectified camera frame."""
        return self.cam_SE3_velo[:3, 3]

    def velo_to_cam(self, points_velo: NDArray[np.floating]) -> Floats:
        """(N, 3+) points of the LiDAR frame -> (N, 3) in the rectified camera frame."""
        return points_velo[:, :3] @ self.cam_SE3_velo[:3, :3].T + self.cam_SE3_velo[:3, 3]

    def cam_to_velo(self, points_cam: NDArray[np.floating]) -> Floats:
        """(N, 3) points of the rectified camera frame -> (N, 3) in the LiDAR frame."""
        velo_SE3_cam = np.linalg.inv(self.cam_SE3_velo).astype(np.float64)
        points_velo: Floats = points_cam[:, :3] @ velo_SE3_cam[:3, :3].T + velo_SE3_cam[:3, 3]
        return points_velo

    def project(self, points_cam: NDArray[np.floating]) -> tuple[Floats, Floats]:
        """(..., 3) points -> pixels (..., 2) and depth (...,) along the optical axis.

        Points at or behind the camera keep their depth <= 0; their pixels mean nothing (NaN).
        """
        image = points_cam @ self.image_P_cam[:, :3].T + self.image_P_cam[:, 3]
        depth_m = image[..., 2]
        in_front = np.where(depth_m > 0, depth_m, np.nan)
        return image[..., :2] / in_front[..., None], depth_m

    def back_project(self, pixels: NDArray[np.floating], depth_m: NDArray[np.floating]) -> Floats:
        """Pixels (..., 2) at depth (...,) -> (..., 3) points in the rectified camera frame."""
        homogeneous = np.concatenate([pixels, np.ones_like(pixels[..., :1])], axis=-1)
        rays = homogeneous * depth_m[..., None] - self.image_P_cam[:, 3]
        solved: Floats = np.linalg.solve(self.image_P_cam[:, :3], rays[..., None])[..., 0]
        return solved

    def _require_physical(self) -> None:
        """Matrices that are numbers but no camera and no LiDAR would give boxes that are no numbers."""
        rotation, translation_m = self.cam_SE3_velo[:3, :3], self.cam_SE3_velo[:3, 3]
        skew = np.abs(rotation @ rotation.T - np.eye(3)).max()
        if (
            not skew < _LARGEST_SKEW
            or np.linalg.det(rotation) < 0
            or (self.cam_SE3_velo[3] != (0, 0, 0, 1)).any()
        ):
            raise CalibrationError(
                "cam_SE3_velo",
                f"{self.cam_SE3_velo.tolist()} is no rigid transform.",
                "Its rotation must be orthonormal and right-handed, its last row 0 0 0 1.",
            )
        if np.abs(translation_m).max() > _LARGEST_OFFSET_M:
            raise CalibrationError(
                "cam_SE3_velo",
                f"the LiDAR would be at {translation_m.tolist()} m.",
                f"Give metres, at most {_LARGEST_OFFSET_M:g} on an axis.",
            )
        axis = self.image_P_cam[2, :3]
        if np.abs(axis - (0, 0, 1)).max() > _LARGEST_SKEW:
            raise CalibrationError(
                "image_P_cam",
                f"its third row begins {axis.tolist()} (scaled to length 1).",
                "It must begin 0 0 1: z of the rectified camera frame is depth.",
            )
        if np.abs(self.image_P_cam).max() > _LARGEST_PIXELS:
            raise CalibrationError(
                "image_P_cam",
                f"{self.image_P_cam.tolist()} holds numbers that no camera has.",
                f"Give pixels, at most {_LARGEST_PIXELS:g}.",
            )


def _finite_matrix(field: str, value: object, shape: tuple[int, int]) -> Floats:
    try:
        matrix = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise CalibrationError(
            field, f"{value!r:.120} is not a matrix of numbers.", f"Give {shape[0]} x {shape[1]} numbers."
        ) from None
    if matrix.shape != shape:
        raise CalibrationError(
            field, f"the shape is {matrix.shape}.", f"Give {shape[0]} x {shape[1]} numbers."
        )
    if not np.isfinite(matrix).all():
        raise CalibrationError(field, f"{matrix.tolist()} is not finite.", "Replace NaN and infinity.")
    return matrix
