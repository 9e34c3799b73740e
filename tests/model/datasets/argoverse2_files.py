"""Writes a generated sweep as logs of Argoverse 2."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow
from pyarrow import feather

from boxlift.camera import Floats
from boxlift.poses import pose, quaternion_of
from model.datasets.town import FRONT, LEFT, Town
from model.datasets.vehicle import (
    EGO_SE3_VELO,
    WORLD_SE3_EGO,
    WORLD_SE3_EGO_AT_IMAGE,
    mount_of,
    objects_ego,
    points_ego,
)

LOG = "022af476-9937-3e70-be52-f65420d52703"
SWEEP_NS, IMAGE_NS = 315966265659927216, 315966265672927216
CAMERAS = {FRONT: "ring_front_center", LEFT: "ring_front_left"}
CATEGORIES = {
    "Car": "REGULAR_VEHICLE",
    "Van": "REGULAR_VEHICLE",
    "Truck": "BOX_TRUCK",
    "Pedestrian": "PEDESTRIAN",
    "Cyclist": "BICYCLIST",
}


def write_log(log: Path, scene: Town) -> None:
    """One sweep, an image of each camera 13 ms later, and one that is too far away in time."""
    (log / "sensors" / "lidar").mkdir(parents=True)
    (log / "calibration").mkdir()
    xyz = points_ego(scene).astype(np.float32)
    _write(log / "sensors" / "lidar" / f"{SWEEP_NS}.feather", dict(zip("xyz", xyz.T, strict=True)))
    for camera, name in CAMERAS.items():
        folder = log / "sensors" / "cameras" / name
        folder.mkdir(parents=True)
        (folder / f"{IMAGE_NS}.jpg").write_bytes(scene.png(camera))
    late = log / "sensors" / "cameras" / "ring_rear_left"
    late.mkdir()
    (late / f"{SWEEP_NS + 80_000_000}.jpg").write_bytes(b"")
    mounts = {CAMERAS[camera]: mount_of(scene, camera) for camera in CAMERAS} | {"up_lidar": EGO_SE3_VELO}
    sensors: dict[str, list[object]] = {"sensor_name": list(mounts)}
    _write(log / "calibration" / "egovehicle_SE3_sensor.feather", sensors | _columns(list(mounts.values())))
    intrinsics: dict[str, list[object]] = {"sensor_name": list(CAMERAS.values())}
    rigs = [scene.cameras[camera].rig for camera in CAMERAS]
    intrinsics |= {"fx_px": [rig.focal_px for rig in rigs], "fy_px": [rig.focal_px for rig in rigs]}
    intrinsics |= {
        "cx_px": [rig.principal_px[0] for rig in rigs],
        "cy_px": [rig.principal_px[1] for rig in rigs],
    }
    intrinsics |= {key: [0.01 for _ in rigs] for key in ("k1", "k2", "k3")}
    intrinsics |= {"height_px": [rig.image_size_px[1] for rig in rigs]}
    intrinsics |= {"width_px": [rig.image_size_px[0] for rig in rigs]}
    _write(log / "calibration" / "intrinsics.feather", intrinsics)
    times: dict[str, list[object]] = {"timestamp_ns": [SWEEP_NS, IMAGE_NS]}
    _write(log / "city_SE3_egovehicle.feather", times | _columns([WORLD_SE3_EGO, WORLD_SE3_EGO_AT_IMAGE]))
    objects = objects_ego(scene)
    boxes: dict[str, list[object]] = {
        "timestamp_ns": [SWEEP_NS for _ in objects],
        "track_uuid": [f"track-{number}" for number in range(len(objects))],
        "category": [CATEGORIES[each.category] for each in objects],
        "length_m": [each.length_m for each in objects],
        "width_m": [each.width_m for each in objects],
        "height_m": [each.height_m for each in objects],
        "num_interior_pts": [30 for _ in objects],
    }
    places = _columns([pose(each.ego_SO3_object, each.center_ego) for each in objects])
    _write(log / "annotations.feather", boxes | places)


def _columns(transforms: list[Floats]) -> dict[str, list[object]]:
    quaternions = [quaternion_of(each[:3, :3]) for each in transforms]
    columns: dict[str, list[object]] = {
        key: [quaternion[index] for quaternion in quaternions]
        for index, key in enumerate(("qw", "qx", "qy", "qz"))
    }
    return columns | {
        key: [float(each[row, 3]) for each in transforms] for row, key in enumerate(("tx_m", "ty_m", "tz_m"))
    }


def _write(path: Path, columns: Mapping[str, object]) -> None:
    feather.write_feather(pyarrow.table(columns), str(path))
