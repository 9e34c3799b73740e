"""KITTI tracking: sequences of one drive each.

    ROOT/training/image_02/0000/000003.png   velodyne/0000/000003.bin   calib/0000.txt
                  oxts/0000.txt              optional: poses
                  label_02/0000.txt          optional: --prompts label_02

training/, testing/ or their parent may be given. Frames are called 0000_000003. The ego frame is the LiDAR's.
Source: readme of the KITTI tracking development kit (Geiger et al., CVPR 2012).
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Floats
from boxlift.datasets.folder_files import files_by_stem
from boxlift.datasets.posed_source import PosedSource, Shot
from boxlift.errors import DatasetError, NoLidarError
from boxlift.formats import image, kitti_tracks, point_cloud
from boxlift.formats.calibration import imu_to_velo, read_calibration
from boxlift.formats.ego_boxes import ego_objects_of_kitti
from boxlift.formats.kitti_label import KittiObject
from boxlift.formats.kitti_tracks import TrackedObject
from boxlift.formats.oxts import imu_poses
from boxlift.poses import inverse
from boxlift.storage import is_folder, read_whole
from boxlift.sweep import EgoObject

if TYPE_CHECKING:
    from boxlift.storage import AnyPath

_CAMERA = "image_02"
LABELS = "label_02"


class KittiTracking(PosedSource):
    """FrameSource for one split of KITTI tracking."""

    layout = "KITTI tracking"

    def __init__(self, root: AnyPath) -> None:
        super().__init__(root)
        if is_folder(root / LABELS):
            self.label_names = (LABELS,)
        # Per source, so that a run does not read a sequence's files for each of its frames.
        self._points = lru_cache(lambda log: files_by_stem(root / "velodyne" / log, (".bin",)))
        self._images = lru_cache(lambda log: files_by_stem(root / _CAMERA / log, image.SUFFIXES))
        self._calibration = lru_cache(lambda log: read_calibration(root / "calib" / f"{log}.txt").calibration)
        self._tracks = lru_cache(self._read_tracks)
        self._poses = lru_cache(self._read_poses)
        self._size_px = lru_cache(self._read_size)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all frames, sorted."""
        folders = {each.name for part in (_CAMERA, "velodyne") for each in _folders(self.root / part)}
        return tuple(
            f"{log}_{stem}"
            for log in sorted(folders)
            for stem in sorted(self._points(log).keys() | self._images(log).keys())
        )

    def shot(self, name: str) -> Shot:
        """See PosedSource."""
        log, stem = self._find(name)
        calibration, poses = self._calibration(log), self._poses(log)
        number = int(stem)
        return Shot(
            sweep=name,
            log=log,
            camera=_CAMERA,
            image_P_cam=calibration.image_P_cam,
            size_px=self._size_px(log),
            mount_SE3_cam=inverse(calibration.cam_SE3_velo),
            lidar_origin_ego=np.zeros(3),
            world_SE3_ego=poses[number] if number < len(poses) else None,
        )

    def points_ego(self, name: str) -> NDArray[np.floating]:
        """See PosedSource."""
        log, stem = self._find(name)
        if stem not in self._points(log):  # as in 0001, of which four sweeps are missing
            raise NoLidarError(
                str(self.root / "velodyne" / log), f"frame {name!r} has no LiDAR points.", "Skip the frame."
            )
        return point_cloud.read_points(self._points(log)[stem]).points

    def encoded_image(self, name: str) -> tuple[bytes, str]:
        """See PosedSource."""
        log, stem = self._find(name)
        path = self._images(log).get(stem)
        if path is None:
            raise DatasetError(str(self.root / _CAMERA / log), f"frame {name!r} has no image.", "Add it.")
        return image.read_image(path), str(path)

    def objects(self, labels: str, name: str) -> list[KittiObject]:
        """The lines of the frame as they are: they are in its camera already."""
        return [each.line for each in self._tracked(labels, name)]

    def ego_objects(self, labels: str, name: str) -> list[EgoObject]:
        """See PosedSource."""
        known = [each for each in self._tracked(labels, name) if each.line.has_box3d]
        boxes = ego_objects_of_kitti([each.line for each in known], self.shot(name).mount_SE3_cam)
        return [replace(box, track_id=str(each.track)) for box, each in zip(boxes, known, strict=True)]

    def _tracked(self, labels: str, name: str) -> list[TrackedObject]:
        log, stem = self._find(name)
        if labels != LABELS:
            raise DatasetError(labels, f"frame {name!r} has no such annotations.", f"Give {LABELS}.")
        return self._tracks(log).get(int(stem), [])

    def _read_tracks(self, log: str) -> dict[int, list[TrackedObject]]:
        path = self.root / LABELS / f"{log}.txt"
        if not path.is_file():
            raise DatasetError(str(path), f"the sequence {log} has no labels.", "Add them.")
        return kitti_tracks.read_tracks(path)

    def _read_poses(self, log: str) -> list[Floats]:
        path = self.root / "oxts" / f"{log}.txt"
        if not path.is_file():
            return []
        lines = read_whole(path).decode().splitlines()
        imu_SE3_velo = inverse(imu_to_velo(self.root / "calib" / f"{log}.txt"))
        return [each @ imu_SE3_velo for each in imu_poses(lines, str(path))]

    def _read_size(self, log: str) -> tuple[int, int]:
        paths = self._images(log)
        if not paths:
            raise DatasetError(str(self.root / _CAMERA / log), "the sequence has no images.", "Add them.")
        path = paths[min(paths)]
        return image.image_size(path, str(path))

    def _find(self, name: str) -> tuple[str, str]:
        log, _, stem = name.rpartition("_")
        if not log or (stem not in self._points(log) and stem not in self._images(log)):
            raise self._no_frame(name)
        return log, stem


def recognise(root: AnyPath) -> KittiTracking | None:
    """A folder that holds image_02/ with sequences, or a split of that kind (training before testing)."""
    for folder in (root, root / "training", root / "testing"):
        if is_folder(folder / _CAMERA) and is_folder(folder / "calib"):
            return KittiTracking(folder)
    return None


def _folders(folder: AnyPath) -> list[AnyPath]:
    return [each for each in folder.iterdir() if is_folder(each)] if is_folder(folder) else []
