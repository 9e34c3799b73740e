"""Writes a generated sweep as a segment of Waymo's version 2: range image, pixel poses, images, boxes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow
from numpy.typing import NDArray
from pyarrow import parquet

from boxlift.camera import Floats
from boxlift.formats.ego_boxes import LOOKING_AHEAD
from boxlift.poses import about_z, inverse, pose
from model.datasets.town import FRONT, LEFT, Town
from model.datasets.vehicle import (
    EGO_SE3_VELO,
    WORLD_SE3_EGO,
    WORLD_SE3_EGO_AT_IMAGE,
    mount_of,
    objects_ego,
)

SEGMENT = "10017090168044687777_6380_000_6400_000"
TIME = 1550083467346370
CAMERAS = {FRONT: (1, "FRONT"), LEFT: (2, "FRONT_LEFT")}
TYPES = {"Car": 1, "Van": 1, "Truck": 1, "Pedestrian": 2, "Cyclist": 4}
# The roof LiDAR is turned on its axis, as Waymo's are.
EGO_SE3_LIDAR = pose(about_z(2.6), EGO_SE3_VELO[:3, 3])
DISTORTION = (0.04, -0.3, 0.001, -0.0005, 0.0)
_HEIGHT, _WIDTH = 200, 2650


def write_waymo(
    split: Path, scene: Town, *, distorted: bool = False, pixel_poses: bool = True
) -> NDArray[np.int64]:
    """Writes training/ or so; returns the indices of the town's points that are in the range image."""
    image, chosen, inclinations = range_image(scene)
    top = {"key.laser_name": 1}
    key = {"key.segment_context_name": SEGMENT, "key.frame_timestamp_micros": TIME}
    lidar = "[LiDARComponent].range_image_return1."
    side = key | {"key.laser_name": 2, f"{lidar}values": [7.0, 0.1, 0, 0], f"{lidar}shape": [1, 1, 4]}
    roof = key | top | {f"{lidar}values": image.ravel().tolist(), f"{lidar}shape": list(image.shape)}
    _write(split, "lidar", [side, roof])
    calibration = "[LiDARCalibrationComponent]."
    _write(
        split,
        "lidar_calibration",
        [
            {"key.segment_context_name": SEGMENT}
            | top
            | {
                f"{calibration}extrinsic.transform": EGO_SE3_LIDAR.ravel().tolist(),
                f"{calibration}beam_inclination.min": float(inclinations[0]),
                f"{calibration}beam_inclination.max": float(inclinations[-1]),
                f"{calibration}beam_inclination.values": inclinations.tolist(),
            }
        ],
    )
    if pixel_poses:
        # The vehicle stood where it was at the sweep's time for all pixels.
        yaw = float(np.arctan2(WORLD_SE3_EGO[1, 0], WORLD_SE3_EGO[0, 0]))
        poses = np.broadcast_to([0, 0, yaw, *WORLD_SE3_EGO[:3, 3]], (*image.shape[:2], 6))
        title = "[LiDARPoseComponent].range_image_return1."
        row = key | top | {f"{title}values": poses.ravel().tolist(), f"{title}shape": list(poses.shape)}
        _write(split, "lidar_pose", [row])
    world = {"[VehiclePoseComponent].world_from_vehicle.transform": WORLD_SE3_EGO.ravel().tolist()}
    _write(split, "vehicle_pose", [key | world])
    images, cameras, drawn = [], [], []
    for camera, (number, _) in CAMERAS.items():
        rig = scene.cameras[camera].rig
        named = {"key.camera_name": number}
        images.append(
            key
            | named
            | {
                "[CameraImageComponent].image": scene.png(camera),
                "[CameraImageComponent].pose.transform": WORLD_SE3_EGO_AT_IMAGE.ravel().tolist(),
            }
        )
        mount = mount_of(scene, camera) @ inverse(LOOKING_AHEAD)
        focal, (cx, cy) = rig.focal_px, rig.principal_px
        numbers = {"f_u": focal, "f_v": focal, "c_u": cx, "c_v": cy}
        bend = DISTORTION if distorted else (0.0,) * 5
        numbers |= dict(zip(("k1", "k2", "p1", "p2", "k3"), bend, strict=True))
        title = "[CameraCalibrationComponent]."
        cameras.append(
            {"key.segment_context_name": SEGMENT}
            | named
            | {f"{title}intrinsic.{name}": float(value) for name, value in numbers.items()}
            | {f"{title}extrinsic.transform": mount.ravel().tolist()}
            | {f"{title}width": rig.image_size_px[0], f"{title}height": rig.image_size_px[1]}
        )
        title = "[CameraBoxComponent]."
        for index, prompt in enumerate(scene.cameras[camera].frame.prompts):
            x1, y1, x2, y2 = prompt.box_px
            drawn.append(
                key
                | named
                | {"key.camera_object_id": f"drawn-{index}", f"{title}type": TYPES[prompt.category]}
                | {f"{title}box.center.x": (x1 + x2) / 2, f"{title}box.center.y": (y1 + y2) / 2}
                | {f"{title}box.size.x": x2 - x1, f"{title}box.size.y": y2 - y1}
            )
    _write(split, "camera_image", images)
    _write(split, "camera_calibration", cameras)
    _write(split, "camera_box", drawn)
    title = "[LiDARBoxComponent]."
    boxes = []
    for index, each in enumerate(objects_ego(scene)):
        center = {
            f"{title}box.center.{axis}": float(v) for axis, v in zip("xyz", each.center_ego, strict=True)
        }
        sides = zip("xyz", (each.length_m, each.width_m, each.height_m), strict=True)
        boxes.append(
            key
            | {"key.laser_object_id": f"box-{index}", f"{title}type": TYPES[each.category]}
            | center
            | {f"{title}box.size.{axis}": value for axis, value in sides}
            | {f"{title}box.heading": each.yaw_rad, f"{title}num_lidar_points_in_box": 12}
            | {f"{title}difficulty_level.detection": 2 if index == 0 else 0}
        )
    _write(split, "lidar_box", boxes)
    return chosen


def range_image(scene: Town) -> tuple[Floats, NDArray[np.int64], Floats]:
    """(H, W, 4) with one of the town's points in each pixel that sees any, the indices of those points, and
    the inclinations of the rows from the lowest."""
    lidar_SO3_velo = EGO_SE3_LIDAR[:3, :3].T
    points = scene.points_velo[:, :3].astype(np.float64) @ lidar_SO3_velo.T
    range_m = np.linalg.norm(points, axis=1)
    elevation = np.arcsin(points[:, 2] / range_m)
    edges = np.linspace(elevation.min(), elevation.max(), _HEIGHT + 1)
    inclinations = (edges[:-1] + edges[1:]) / 2
    beam = np.clip(np.digitize(elevation, edges) - 1, 0, _HEIGHT - 1)
    turned = np.arctan2(EGO_SE3_LIDAR[1, 0], EGO_SE3_LIDAR[0, 0])
    azimuth = np.arctan2(points[:, 1], points[:, 0]) + turned
    azimuth = (azimuth + np.pi) % (2 * np.pi) - np.pi
    column = np.clip(((1 - (azimuth / np.pi + 1) / 2) * _WIDTH).astype(int), 0, _WIDTH - 1)
    image = np.full((_HEIGHT, _WIDTH, 4), -1.0)
    _, chosen = np.unique((_HEIGHT - 1 - beam) * _WIDTH + column, return_index=True)
    rows = _HEIGHT - 1 - beam[chosen]
    image[rows, column[chosen], 0] = range_m[chosen]
    image[rows, column[chosen], 1:] = 0.5
    return image, chosen, inclinations


def _write(split: Path, component: str, rows: Sequence[Mapping[str, object]]) -> None:
    (split / component).mkdir(parents=True, exist_ok=True)
    parquet.write_table(pyarrow.Table.from_pylist(list(rows)), split / component / f"{SEGMENT}.parquet")
