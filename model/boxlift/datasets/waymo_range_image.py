"""Waymo's range images -> points in the vehicle frame at the sweep's time.

A row is a beam, from the top; a column an azimuth, from behind the vehicle clockwise. While the LiDAR turns
the vehicle moves: the roof LiDAR has a pose for every pixel. Source: range_image_utils.py and frame_utils.py
in waymo_open_dataset/utils.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Floats
from boxlift.poses import inverse


def points_of_range_image(
    range_image: Floats,
    inclinations: Sequence[float] | None,
    inclination_limits: tuple[float, float],
    ego_SE3_lidar: Floats,
    pixel_poses: Floats | None,
    world_SE3_ego: Floats,
) -> NDArray[np.float32]:
    """(N, 4) x, y, z, intensity.

    range_image: (H, W, 2+) range in metres (0 or less for no return) and intensity. inclinations: (H,)
    radians from the lowest beam; where None, the beams share the limits evenly. pixel_poses: (H, W, 6) roll,
    pitch, yaw, x, y, z of the vehicle in the world; None where it stood still.
    """
    height, width = range_image.shape[:2]
    if inclinations is None or len(inclinations) == 0:
        low, high = inclination_limits
        inclinations = np.asarray(low + (np.arange(height) + 0.5) / height * (high - low)).tolist()
    elevation = np.asarray(inclinations, dtype=np.float64)[::-1]
    turned = np.arctan2(ego_SE3_lidar[1, 0], ego_SE3_lidar[0, 0])
    azimuth = ((width - np.arange(width) - 0.5) / width * 2 - 1) * np.pi - turned
    rows, columns = np.nonzero(range_image[..., 0] > 0)
    range_m, intensity = range_image[rows, columns, 0], range_image[rows, columns, 1]
    flat = range_m * np.cos(elevation[rows])
    points_lidar = np.stack(
        [
            flat * np.cos(azimuth[columns]),
            flat * np.sin(azimuth[columns]),
            range_m * np.sin(elevation[rows]),
        ],
        axis=1,
    )
    points_ego = points_lidar @ ego_SE3_lidar[:3, :3].T + ego_SE3_lidar[:3, 3]
    if pixel_poses is not None:
        poses = pixel_poses[rows, columns]
        points_world = np.einsum("nij,nj->ni", _rotations(poses[:, :3]), points_ego) + poses[:, 3:]
        ego_SE3_world = inverse(world_SE3_ego)
        points_ego = points_world @ ego_SE3_world[:3, :3].T + ego_SE3_world[:3, 3]
    return np.column_stack([points_ego, intensity]).astype(np.float32)


def _rotations(roll_pitch_yaw: Floats) -> Floats:
    """(N, 3) radians -> (N, 3, 3): about x, then y, then z."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(roll_pitch_yaw).T, np.sin(roll_pitch_yaw).T
    rows = [
        *(cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        *(sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        *(-sp, cp * sr, cp * cr),
    ]
    return np.stack(rows, axis=1).reshape(-1, 3, 3)
