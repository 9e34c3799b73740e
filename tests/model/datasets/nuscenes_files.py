"""Writes a generated sweep as a data set of nuScenes: one scene, one sample, two cameras."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from boxlift.camera import Floats
from boxlift.poses import about_z, inverse, pose, quaternion_of
from model.datasets.town import FRONT, LEFT, Town
from model.datasets.vehicle import (
    EGO_SE3_VELO,
    WORLD_SE3_EGO,
    WORLD_SE3_EGO_AT_IMAGE,
    mount_of,
    objects_ego,
    points_ego,
)

SAMPLE = "ca9a282c9e77460f8360f564131a8af5"
CHANNELS = {FRONT: "CAM_FRONT", LEFT: "CAM_FRONT_LEFT"}
CATEGORIES = {
    "Car": "vehicle.car",
    "Van": "vehicle.car",
    "Truck": "vehicle.truck",
    "Pedestrian": "human.pedestrian.adult",
    "Cyclist": "vehicle.bicycle",
}
# nuScenes' LiDAR looks with y ahead and x to the right.
EGO_SE3_LIDAR = pose(about_z(-np.pi / 2), EGO_SE3_VELO[:3, 3])
_MICROSECONDS = 1532402927647951


def write_nuscenes(root: Path, scene: Town, *, points_in_boxes: int = 20) -> None:
    """ROOT/v1.0-mini and ROOT/samples, with a sweep between key frames that no reader should take for one."""
    tables: dict[str, list[dict[str, Any]]] = {
        "scene": [{"token": "scene", "name": "scene-0061", "description": ""}],
        "sample": [
            {"token": SAMPLE, "timestamp": _MICROSECONDS, "scene_token": "scene", "prev": "", "next": ""}
        ],
        "sensor": [{"token": "s-lidar", "channel": "LIDAR_TOP", "modality": "lidar"}],
        "calibrated_sensor": [
            _transform("c-lidar", EGO_SE3_LIDAR, sensor_token="s-lidar", camera_intrinsic=[])
        ],
        "ego_pose": [
            _transform("at-sweep", WORLD_SE3_EGO, timestamp=_MICROSECONDS),
            _transform("at-image", WORLD_SE3_EGO_AT_IMAGE, timestamp=_MICROSECONDS + 50_000),
            _transform("between", np.eye(4), timestamp=_MICROSECONDS + 90_000),
        ],
        "sample_data": [_file("d-lidar", "LIDAR_TOP", "c-lidar", "at-sweep", "pcd.bin", (0, 0))],
        "category": [{"token": name, "name": name, "description": ""} for name in set(CATEGORIES.values())],
        "attribute": [
            {"token": "a-parked", "name": "vehicle.parked", "description": ""},
            {"token": "a-ridden", "name": "cycle.with_rider", "description": ""},
        ],
        "visibility": [{"token": "4", "level": "v80-100", "description": ""}],
        "instance": [],
        "sample_annotation": [],
    }
    lidar = inverse(EGO_SE3_LIDAR)
    points = points_ego(scene) @ lidar[:3, :3].T + lidar[:3, 3]
    rows = np.column_stack([points, scene.points_velo[:, 3], np.zeros(len(points))]).astype("<f4")
    (root / "samples" / "LIDAR_TOP").mkdir(parents=True)
    (root / _name("LIDAR_TOP", "pcd.bin")).write_bytes(rows.tobytes())
    for camera, channel in CHANNELS.items():
        rig = scene.cameras[camera].rig
        (root / "samples" / channel).mkdir()
        (root / _name(channel, "jpg")).write_bytes(scene.png(camera))
        tables["sensor"].append({"token": f"s-{channel}", "channel": channel, "modality": "camera"})
        mounted = _transform(f"c-{channel}", mount_of(scene, camera), sensor_token=f"s-{channel}")
        tables["calibrated_sensor"].append(mounted | {"camera_intrinsic": rig.projection[:, :3].tolist()})
        seen = _file(f"d-{channel}", channel, f"c-{channel}", "at-image", "jpg", rig.image_size_px)
        between = _file(f"b-{channel}", channel, f"c-{channel}", "between", "jpg", rig.image_size_px)
        tables["sample_data"] += [seen, between | {"is_key_frame": False}]
    for number, each in enumerate(objects_ego(scene)):
        world = WORLD_SE3_EGO @ pose(each.ego_SO3_object, each.center_ego)
        box = _transform(f"box-{number}", world, sample_token=SAMPLE, instance_token=f"i-{number}")
        box |= {"size": [each.width_m, each.length_m, each.height_m], "visibility_token": "4"}
        attributes = {"Car": ["a-parked"], "Cyclist": ["a-ridden"]}
        box |= {"attribute_tokens": attributes.get(each.category, [])}
        box |= {"num_lidar_pts": points_in_boxes, "num_radar_pts": 0}
        tables["sample_annotation"].append(box)
        tables["instance"].append({"token": f"i-{number}", "category_token": CATEGORIES[each.category]})
    (root / "v1.0-mini").mkdir()
    for table, records in tables.items():
        (root / "v1.0-mini" / f"{table}.json").write_text(json.dumps(records))


def _transform(token: str, matrix: Floats, **more: Any) -> dict[str, Any]:
    rotation, translation = list(quaternion_of(matrix[:3, :3])), matrix[:3, 3].tolist()
    return {"token": token, "rotation": rotation, "translation": translation, **more}


def _file(
    token: str, channel: str, calibrated: str, ego_pose: str, kind: str, size_px: tuple[int, int]
) -> dict[str, Any]:
    return {
        "token": token,
        "sample_token": SAMPLE,
        "ego_pose_token": ego_pose,
        "calibrated_sensor_token": calibrated,
        "timestamp": _MICROSECONDS,
        "fileformat": kind,
        "is_key_frame": True,
        "width": size_px[0],
        "height": size_px[1],
        "filename": _name(channel, kind),
    }


def _name(channel: str, kind: str) -> str:
    return f"samples/{channel}/n015__{channel}__{_MICROSECONDS}.{kind}"
