"""A vehicle that carries the town's sensors and drives while they look: ego frame, poses, mounts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from boxlift.camera import Floats
from boxlift.poses import about_z, inverse, pose
from boxlift.sweep import EgoObject
from model.datasets.town import Town

# The LiDAR over the rear axle, with the axes of the vehicle.
EGO_SE3_VELO = pose(np.eye(3), np.array([0.9, 0.1, 1.8]))
# Where the vehicle was in the world when the LiDAR looked, and a moment later when the cameras did.
WORLD_SE3_EGO = pose(about_z(0.7), np.array([410.0, 1180.0, 3.0]))
WORLD_SE3_EGO_AT_IMAGE = pose(about_z(0.72), np.array([410.3, 1180.25, 3.01]))


def mount_of(scene: Town, camera: str) -> Floats:
    """ego_SE3_cam as it is bolted on, seeing what it sees from where the vehicle is by then."""
    seen_from = WORLD_SE3_EGO @ EGO_SE3_VELO @ scene.velo_SE3_cam(camera)
    return inverse(WORLD_SE3_EGO_AT_IMAGE) @ seen_from


def points_ego(scene: Town) -> Floats:
    """(N, 3) in the ego frame."""
    return scene.points_velo[:, :3].astype(np.float64) + EGO_SE3_VELO[:3, 3]


def objects_ego(scene: Town) -> list[EgoObject]:
    """The truth in the ego frame."""
    return [replace(each, center_ego=each.center_ego + EGO_SE3_VELO[:3, 3]) for each in scene.objects]
