"""Labels as a project of Supervisely for point clouds, which CVAT imports too ("Sly Point Cloud Format").

    PROJECT/meta.json, key_id_map.json
    PROJECT/ds0/ann/SWEEP.pcd.json
    PROJECT/ds0/pointcloud/SWEEP.pcd                       points in the ego frame
    PROJECT/ds0/related_images/SWEEP_pcd/CAMERA.png(.json) images and how points fall into them

A cuboid has its centre, its rotation about z (about x and y: 0) and its sizes along x (length), y (width)
and z, all in the ego frame. Source: Supervisely's documentation of point cloud projects.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any
from uuid import NAMESPACE_URL, uuid5

import numpy as np
from numpy.typing import NDArray

from boxlift.formats.image import encoded_png
from boxlift.poses import inverse
from boxlift.storage import write_whole
from boxlift.sweep import CameraImage, EgoObject, SweepLabels, SweepSensors

if TYPE_CHECKING:
    from boxlift.storage import AnyPath

DATASET = "ds0"
_COLORS = ("#2E86DE", "#E67E22", "#27AE60", "#C0392B", "#8E44AD", "#16A085", "#F1C40F", "#7F8C8D")
_TAGS = {"score": "any_number", "flags": "any_string", "cameras": "any_string"}


class SuperviselyProject:
    """A project that sweeps are added to; `finish` writes what is of all of them."""

    def __init__(self, root: AnyPath) -> None:
        self._root = root
        self._classes: list[str] = []
        self._keys: dict[str, dict[str, int]] = {"tags": {}, "objects": {}, "figures": {}, "videos": {}}

    def add(self, name: str, labels: SweepLabels, sensors: SweepSensors | None) -> None:
        """One sweep under a file's name, with its points and images where they are. Raises OSError."""
        folder = self._root / DATASET
        key = self._key("videos", name)
        objects, figures = [], []
        for index, each in enumerate(labels.objects):
            if each.category not in self._classes:
                self._classes.append(each.category)
            track = None if each.track_id is None else f"{labels.log}/{each.track_id}"
            object_key = self._key("objects", track or f"{name}/{index}")
            objects.append({"key": object_key, "classTitle": each.category, "tags": _tags(each, object_key)})
            figures.append(
                {
                    "key": self._key("figures", f"{name}/{index}"),
                    "objectKey": object_key,
                    "geometryType": "cuboid_3d",
                    "geometry": _geometry(each),
                }
            )
        annotation = {"description": "", "key": key, "tags": [], "objects": objects, "figures": figures}
        _write_json(folder / "ann" / f"{name}.pcd.json", annotation)
        if sensors is None:
            return
        write_whole(folder / "pointcloud" / f"{name}.pcd", pcd_of(sensors.points_ego))
        for image in sensors.images:
            beside = folder / "related_images" / f"{name}_pcd"
            file = f"{image.camera}.png"
            write_whole(beside / file, encoded_png(image.image))
            _write_json(beside / f"{file}.json", {"name": file, "meta": _camera(image)})

    def finish(self) -> None:
        """Classes, and the numbers of all keys. Raises OSError."""
        classes = [
            {"title": title, "shape": "cuboid_3d", "color": _COLORS[index % len(_COLORS)]}
            for index, title in enumerate(self._classes)
        ]
        common = {"color": "#999999", "applicable_type": "objectsOnly"}
        tags = [{"name": name, "value_type": kind, **common} for name, kind in _TAGS.items()]
        meta = {"classes": classes, "tags": tags, "projectType": "point_clouds"}
        _write_json(self._root / "meta.json", meta)
        _write_json(self._root / "key_id_map.json", self._keys)

    def _key(self, kind: str, name: str) -> str:
        """A key that is the same whenever the same labels are converted."""
        key = uuid5(NAMESPACE_URL, f"boxlift:{kind}:{name}").hex
        self._keys[kind].setdefault(key, len(self._keys[kind]))
        return key


def pcd_of(points: NDArray[np.float32]) -> bytes:
    """(N, 3+) points -> a binary .pcd file of x, y, z."""
    xyz = np.ascontiguousarray(points[:, :3], dtype="<f4")
    lines: Iterable[str] = (
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        "FIELDS x y z",
        "SIZE 4 4 4",
        "TYPE F F F",
        "COUNT 1 1 1",
        f"WIDTH {len(xyz)}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {len(xyz)}",
        "DATA binary",
    )
    return ("\n".join(lines) + "\n").encode() + xyz.tobytes()


def _geometry(each: EgoObject) -> dict[str, dict[str, float]]:
    x, y, z = each.center_ego.tolist()
    return {
        "position": {"x": x, "y": y, "z": z},
        "rotation": {"x": 0.0, "y": 0.0, "z": each.yaw_rad},
        "dimensions": {"x": each.length_m, "y": each.width_m, "z": each.height_m},
    }


def _tags(each: EgoObject, object_key: str) -> list[dict[str, Any]]:
    values: dict[str, Any] = {
        "score": each.score,
        "flags": " ".join(each.flags),
        "cameras": " ".join(each.cameras),
    }
    return [
        {"name": name, "value": value, "key": uuid5(NAMESPACE_URL, f"{object_key}:{name}").hex}
        for name, value in values.items()
        if value != ""
    ]


def _camera(image: CameraImage) -> dict[str, Any]:
    # A projection with a fourth column is a camera beside the rectified frame's origin.
    intrinsic = image.image_P_cam[:, :3]
    cam_SE3_ego = inverse(image.ego_SE3_cam)
    extrinsic = cam_SE3_ego[:3].copy()
    extrinsic[:, 3] += np.linalg.solve(intrinsic, image.image_P_cam[:, 3])
    matrices = {"extrinsicMatrix": extrinsic.ravel().tolist(), "intrinsicMatrix": intrinsic.ravel().tolist()}
    return {"deviceId": image.camera, "sensorsData": matrices}


def _write_json(path: AnyPath, content: object) -> None:
    write_whole(path, (json.dumps(content, indent=1) + "\n").encode())
