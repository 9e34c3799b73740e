"""nuScenes: key frames of six cameras and one LiDAR.

    ROOT/v1.0-mini/*.json                     tables; of several trainval, then mini, then test
    ROOT/samples/LIDAR_TOP/*.pcd.bin          float32 x, y, z, intensity, ring
    ROOT/samples/CAM_FRONT/*.jpg, ...

ROOT, or one folder of tables in it, may be given. A frame is one camera's image of a sample, called
SAMPLETOKEN_CAM_FRONT; the sweep is the sample, the log the scene's name. The ego frame is nuScenes' own, at
the LiDAR's moment; images are rectified already. `--prompts annotations` takes the outlines of the boxes that
hold LiDAR or radar points. Source: Caesar et al., CVPR 2020, and the schema of nuscenes-devkit.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Floats
from boxlift.datasets.nuscenes_tables import LIDAR, NuscenesTables, transform_of
from boxlift.datasets.posed_source import ANNOTATIONS, PosedSource, Shot
from boxlift.errors import DatasetError, NoLidarError, PointCloudError
from boxlift.formats import image
from boxlift.poses import inverse, rotation_of
from boxlift.storage import read_input
from boxlift.sweep import EgoObject

if TYPE_CHECKING:
    from boxlift.storage import AnyPath

_VERSIONS = ("v1.0-trainval", "v1.0-mini", "v1.0-test")
_COLUMNS = 5


class Nuscenes(PosedSource):
    """FrameSource for one version of nuScenes."""

    layout = "nuScenes"

    def __init__(self, root: AnyPath, version: str) -> None:
        super().__init__(root)
        self._tables = NuscenesTables(root / version)
        if self._tables.has_annotations:
            self.label_names = (ANNOTATIONS,)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all frames, sorted."""
        return tuple(
            sorted(
                f"{token}_{channel}"
                for token, files in self._tables.channels.items()
                for channel in files
                if channel != LIDAR
            )
        )

    def shot(self, name: str) -> Shot:
        """See PosedSource."""
        token, camera = self._find(name)
        tables = self._tables
        seen, scanned = tables.channels[token][camera], tables.channels[token].get(LIDAR)
        mounted = tables.calibrated[seen["calibrated_sensor_token"]]
        intrinsic = np.array(mounted["camera_intrinsic"], dtype=np.float64)
        origin, world_SE3_ego = np.zeros(3), tables.poses[seen["ego_pose_token"]]
        if scanned is not None:
            lidar = tables.calibrated[scanned["calibrated_sensor_token"]]
            origin = np.array(lidar["translation"], dtype=np.float64)
            world_SE3_ego = tables.poses[scanned["ego_pose_token"]]
        sample = tables.samples[token]
        return Shot(
            sweep=token,
            log=tables.scene_names[sample["scene_token"]],
            camera=camera,
            image_P_cam=np.column_stack([intrinsic, np.zeros(3)]),
            size_px=(int(seen["width"]), int(seen["height"])),
            mount_SE3_cam=transform_of(mounted),
            lidar_origin_ego=origin,
            timestamp_ns=int(sample["timestamp"]) * 1000,
            world_SE3_ego=world_SE3_ego,
            world_SE3_ego_at_image=tables.poses[seen["ego_pose_token"]],
        )

    def points_ego(self, name: str) -> NDArray[np.floating]:
        """See PosedSource."""
        token, _ = self._find(name)
        scanned = self._tables.channels[token].get(LIDAR)
        if scanned is None:
            raise NoLidarError(str(self.root), f"sample {token} has no {LIDAR}.", "Skip the frame.")
        path = self.root / str(scanned["filename"])
        mount = transform_of(self._tables.calibrated[scanned["calibrated_sensor_token"]])
        points = read_sweep_file(path, _COLUMNS)
        points[:, :3] = points[:, :3] @ mount[:3, :3].T.astype(np.float32) + mount[:3, 3].astype(np.float32)
        return points

    def encoded_image(self, name: str) -> tuple[bytes, str]:
        """See PosedSource."""
        token, camera = self._find(name)
        path = self.root / str(self._tables.channels[token][camera]["filename"])
        return image.read_image(path), str(path)

    def ego_objects(self, labels: str, name: str) -> list[EgoObject]:
        """See PosedSource."""
        token, _ = self._find(name)
        if labels not in self.label_names:
            raise DatasetError(str(self.root), "the version has no annotations.", "Give a folder of labels.")
        ego_SE3_world = inverse(self._world_SE3_ego(name))
        objects = []
        for each in self._tables.annotations.get(token, []):
            width, length, height = (float(side) for side in each["size"])
            center_world = np.array(each["translation"], dtype=np.float64)
            turn = rotation_of(np.array([each["rotation"]], dtype=np.float64))[0]
            objects.append(
                EgoObject(
                    category=each["category"],
                    center_ego=ego_SE3_world[:3, :3] @ center_world + ego_SE3_world[:3, 3],
                    ego_SO3_object=ego_SE3_world[:3, :3] @ turn,
                    length_m=length,
                    width_m=width,
                    height_m=height,
                    track_id=str(each["instance_token"]),
                    points=int(each["num_lidar_pts"]) + int(each["num_radar_pts"]),
                    attribute=each["attribute"],
                )
            )
        return objects

    def _world_SE3_ego(self, name: str) -> Floats:
        pose = self.shot(name).world_SE3_ego
        assert pose is not None
        return pose

    def _find(self, name: str) -> tuple[str, str]:
        token, _, camera = name.partition("_")
        if camera == LIDAR or camera not in self._tables.channels.get(token, {}):
            raise self._no_frame(name)
        return token, camera


def read_sweep_file(path: AnyPath, columns: int) -> NDArray[np.float32]:
    """(N, columns) float32 returns of a file without header, those that are not finite left out.

    Raises PointCloudError.
    """
    data = read_input(path, PointCloudError)
    if len(data) % (4 * columns) or not data:
        raise PointCloudError(
            str(path),
            f"{len(data)} bytes are no rows of {columns} numbers.",
            "The file is cut off or of another kind.",
        )
    points = np.frombuffer(data, dtype="<f4").reshape(-1, columns)
    return np.array(points[np.isfinite(points[:, :3]).all(axis=1)], dtype=np.float32)


def recognise(root: AnyPath) -> Nuscenes | None:
    """A folder that holds tables in v1.0-*, or one of those."""
    if root.name.startswith("v1.0-") and (root / "sample_data.json").is_file():
        return Nuscenes(root.parent, root.name)
    version = next((each for each in _VERSIONS if (root / each / "sample_data.json").is_file()), None)
    return None if version is None else Nuscenes(root, version)
