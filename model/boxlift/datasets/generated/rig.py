"""Where camera and LiDAR sit and how they look: everything about a rig that a picture depends on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from boxlift.camera import Calibration, Floats
from boxlift.poses import about_z

# x_cam = -y, y_cam = -z, z_cam = x of the LiDAR (and of the scene) where the camera looks ahead.
_AXES_LOOKING_AHEAD = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


def _hdl64e_elevations_deg() -> tuple[float, ...]:
    """Velodyne HDL-64E S2 manual: 32 lasers every 1/3 deg below +2 deg, 32 every 1/2 deg to -24.8 deg."""
    upper, lower = np.linspace(2.0, -8.33, 32), np.linspace(-8.83, -24.8, 32)
    return tuple(float(angle) for angle in np.concatenate([upper, lower]).round(4))


@dataclass(frozen=True)
class Rig:
    """One camera and one LiDAR on a car, in KITTI's terms. Metres, degrees, pixels.

    camera_height_m: the rectified frame's origin above the road (two decimals: it is part of the truth).
    focal_px, principal_px, projection_offset: P2 = [[f, 0, cx, o0], [0, f, cy, o1], [0, 0, 1, o2]].
    lidar_in_cam_m: the LiDAR's origin in the rectified camera frame (x right, y down, z forward).
    lidar_turn_deg: small rotations about the LiDAR's own x, y, z against the camera's axes.
    rectification_deg: small rotations that R0_rect stands for.
    elevations_deg: one per beam; azimuth_step_deg: between two firings.
    range_noise_m: standard deviation along the beam.
    camera_yaw_deg: the camera turned left against the car; the LiDAR is not.
    car_at_m, car_heading_rad: where the car stands in the scene, and how far left of forward it looks.
    """

    name: str
    image_size_px: tuple[int, int]
    focal_px: float
    principal_px: tuple[float, float]
    projection_offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    camera_height_m: float = 1.65
    lidar_in_cam_m: tuple[float, float, float] = (0.0, -0.08, -0.27)
    lidar_turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rectification_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    elevations_deg: tuple[float, ...] = _hdl64e_elevations_deg()
    azimuth_step_deg: float = 0.17
    max_range_m: float = 120.0
    min_range_m: float = 0.9
    range_noise_m: float = 0.02
    camera_yaw_deg: float = 0.0
    car_at_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    car_heading_rad: float = 0.0

    def turned(self, yaw_deg: float, name: str) -> Rig:
        """Another camera at the same place on the same car, turned left by so much; the LiDAR stays."""
        ahead = replace(self, name=name, camera_yaw_deg=yaw_deg)
        lidar_in_cam_m = ahead.cam_axes_of_car @ self.cam_axes_of_car.T @ np.array(self.lidar_in_cam_m)
        x, y, z = (float(value) for value in lidar_in_cam_m)
        return replace(ahead, lidar_in_cam_m=(x, y, z))

    @property
    def cam_axes_of_car(self) -> Floats:
        """(3, 3) directions of the car (x forward, y left, z up) -> of the rectified camera frame."""
        return np.asarray(_AXES_LOOKING_AHEAD @ _rotation((0.0, 0.0, -self.camera_yaw_deg)))

    @property
    def cam_axes_of_scene(self) -> Floats:
        """(3, 3) directions of the scene frame -> of the rectified camera frame."""
        return np.asarray(self.cam_axes_of_car @ about_z(-self.car_heading_rad))

    @property
    def projection(self) -> Floats:
        """(3, 4) projection, KITTI's P2."""
        (cx, cy), (o0, o1, o2) = self.principal_px, self.projection_offset
        return _as_written(
            np.array(
                [[self.focal_px, 0, cx, o0], [0, self.focal_px, cy, o1], [0, 0, 1, o2]], dtype=np.float64
            )
        )

    @property
    def rectification(self) -> Floats:
        """(3, 3) rotation from the unrectified to the rectified camera frame, KITTI's R0_rect."""
        return _as_written(_rotation(self.rectification_deg))

    @property
    def unrectified_from_velo(self) -> Floats:
        """(3, 4) LiDAR frame to unrectified camera frame, KITTI's Tr_velo_to_cam."""
        rotation = self.cam_axes_of_car @ _rotation(self.lidar_turn_deg)
        rectified = np.column_stack([rotation, self.lidar_in_cam_m])
        return _as_written(np.linalg.solve(self.rectification, rectified))

    @property
    def calibration(self) -> Calibration:
        """The calibration that a reader gets from the written file, to the last bit."""
        cam_SE3_velo = np.eye(4)
        cam_SE3_velo[:3] = self.rectification @ self.unrectified_from_velo
        return Calibration(self.projection, cam_SE3_velo)


def _rotation(angles_deg: tuple[float, float, float]) -> Floats:
    """Rotations about x, then y, then z."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(np.deg2rad(angles_deg)), np.sin(np.deg2rad(angles_deg))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


def _as_written(matrix: Floats) -> Floats:
    """Rounded as KITTI's calibration files write numbers."""
    return np.array([[float(f"{value:.12e}") for value in row] for row in matrix])


KITTI_RIG = Rig(
    name="kitti",
    image_size_px=(1242, 375),
    focal_px=721.5377,
    principal_px=(609.5593, 172.854),
    projection_offset=(44.85728, 0.2163791, 0.002745884),
    lidar_turn_deg=(0.4, -0.5, 0.2),
    rectification_deg=(0.3, -0.4, 0.5),
)
"""A 64-beam LiDAR just behind and above a wide colour camera: the layout of KITTI's car."""

ROOF_32_RIG = Rig(
    name="roof32",
    image_size_px=(1600, 900),
    focal_px=1266.4,
    principal_px=(816.3, 491.5),
    camera_height_m=1.51,
    lidar_in_cam_m=(0.02, -0.33, -0.76),
    lidar_turn_deg=(0.3, 0.2, -0.4),
    elevations_deg=tuple(float(angle) for angle in np.linspace(10.67, -30.67, 32).round(4)),
    azimuth_step_deg=0.33,
    max_range_m=70.0,
)
"""A 32-beam LiDAR and a long lens, about as on nuScenes' car (Caesar et al., CVPR 2020)."""

FAR_APART_RIG = Rig(
    name="far_apart",
    image_size_px=(1280, 720),
    focal_px=900.0,
    principal_px=(639.5, 359.5),
    camera_height_m=1.30,
    lidar_in_cam_m=(0.60, -0.90, -1.60),
    lidar_turn_deg=(0.5, 2.0, -1.0),
    azimuth_step_deg=0.2,
)
"""Camera low behind the windscreen, LiDAR high on the other side of the roof: the two see differently."""

RIGS = {rig.name: rig for rig in (KITTI_RIG, ROOF_32_RIG, FAR_APART_RIG)}
