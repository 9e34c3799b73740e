"""Argoverse 2, sensor data set: seven ring cameras (and a stereo pair, not read) and a LiDAR on the roof.

    ROOT/LOG/sensors/lidar/TIMESTAMP.feather           x, y, z in the ego frame, at that moment
    ROOT/LOG/sensors/cameras/ring_front_center/TIMESTAMP.jpg
    ROOT/LOG/calibration/intrinsics.feather, egovehicle_SE3_sensor.feather
    ROOT/LOG/city_SE3_egovehicle.feather               poses
    ROOT/LOG/annotations.feather                       optional: --prompts annotations

ROOT, a split in it (train, val, test) or one log may be given. Frames are the ring cameras' images that are
nearest to a sweep in time, called LOG_TIMESTAMP_ring_front_center after the sweep's time. Images count as
rectified, as they do for the data set's own API. Source: Wilson et al., NeurIPS 2021 (data sets); user guide
of av2-api.
"""

from __future__ import annotations

import bisect
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Floats
from boxlift.datasets.folder_files import FolderFiles
from boxlift.datasets.posed_source import ANNOTATIONS, PosedSource, Shot
from boxlift.errors import CalibrationError, DatasetError, NoLidarError, PointCloudError
from boxlift.formats import argoverse2_boxes, image
from boxlift.formats.tables import read_columns, read_table
from boxlift.poses import pose, rotation_of
from boxlift.storage import is_folder
from boxlift.sweep import EgoObject

if TYPE_CHECKING:
    from boxlift.storage import AnyPath

_LIDAR = "up_lidar"
# The ring cameras run at 20 Hz: what is farther from the sweep belongs to another one.
_LARGEST_GAP_NS = 50_000_000
_QUATERNION, _TRANSLATION = ("qw", "qx", "qy", "qz"), ("tx_m", "ty_m", "tz_m")


@dataclass(frozen=True)
class _Log:
    """One log, read as far as it was asked for."""

    folder: AnyPath

    @cached_property
    def sweeps(self) -> list[int]:
        return _times(self.folder / "sensors" / "lidar", (".feather",))

    @cached_property
    def cameras(self) -> dict[str, list[int]]:
        """Times of the images, by ring camera."""
        folder = self.folder / "sensors" / "cameras"
        names = sorted(each.name for each in folder.iterdir()) if is_folder(folder) else []
        return {name: _times(folder / name, image.SUFFIXES) for name in names if name.startswith("ring_")}

    @cached_property
    def mounts(self) -> dict[str, Floats]:
        """ego_SE3_sensor by sensor."""
        table = read_columns(self.folder / "calibration" / "egovehicle_SE3_sensor.feather")
        return dict(zip(map(str, table["sensor_name"]), _transforms(table), strict=True))

    @cached_property
    def intrinsics(self) -> dict[str, dict[str, Any]]:
        table = read_columns(self.folder / "calibration" / "intrinsics.feather")
        rows = [dict(zip(table, values, strict=True)) for values in zip(*table.values(), strict=True)]
        return {str(row["sensor_name"]): row for row in rows}

    @cached_property
    def poses(self) -> dict[int, Floats]:
        """city_SE3_ego by time; there is one for every file of a sensor."""
        table = read_columns(self.folder / "city_SE3_egovehicle.feather")
        return dict(zip(map(int, table["timestamp_ns"]), _transforms(table), strict=True))

    @cached_property
    def annotations(self) -> dict[int, tuple[EgoObject, ...]]:
        labels = argoverse2_boxes.read_boxes(self.folder / "annotations.feather", self.folder.name)
        return {each.timestamp_ns: each.objects for each in labels if each.timestamp_ns is not None}

    def image_time(self, camera: str, sweep_ns: int) -> int | None:
        """Time of the camera's image nearest to a sweep; None where none is near."""
        times = self.cameras.get(camera, [])
        at = bisect.bisect(times, sweep_ns)
        nearest = min(times[max(at - 1, 0) : at + 1], key=lambda time: abs(time - sweep_ns), default=None)
        return nearest if nearest is not None and abs(nearest - sweep_ns) <= _LARGEST_GAP_NS else None


class Argoverse2(PosedSource):
    """FrameSource for logs of Argoverse 2."""

    layout = "Argoverse 2"

    def __init__(self, root: AnyPath, logs: list[AnyPath]) -> None:
        super().__init__(root)
        self._logs = {folder.name: _Log(folder) for folder in logs}
        if any((folder / "annotations.feather").is_file() for folder in logs):
            self.label_names = (ANNOTATIONS,)
        self._points = lru_cache(maxsize=1)(self._read_points)  # the cameras of a sweep come in turn

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all frames, sorted."""
        return tuple(
            f"{name}_{sweep}_{camera}"
            for name, log in sorted(self._logs.items())
            for sweep in log.sweeps
            for camera in log.cameras
            if log.image_time(camera, sweep) is not None
        )

    def shot(self, name: str) -> Shot:
        """See PosedSource."""
        log, sweep, camera, taken = self._find(name)
        if camera not in log.intrinsics or camera not in log.mounts:
            raise CalibrationError(
                str(log.folder / "calibration"), f"there is no {camera}.", "Give the log's own calibration."
            )
        known = log.intrinsics[camera]
        fx, fy, cx, cy = (float(known[key]) for key in ("fx_px", "fy_px", "cx_px", "cy_px"))
        at_sweep, at_image = log.poses.get(sweep), log.poses.get(taken)
        lidar = log.mounts.get(_LIDAR)
        return Shot(
            sweep=str(sweep),
            log=log.folder.name,
            camera=camera,
            image_P_cam=np.array([[fx, 0, cx, 0], [0, fy, cy, 0], [0, 0, 1, 0]]),
            size_px=(int(known["width_px"]), int(known["height_px"])),
            mount_SE3_cam=log.mounts[camera],
            lidar_origin_ego=np.zeros(3) if lidar is None else lidar[:3, 3],
            timestamp_ns=sweep,
            world_SE3_ego=at_sweep,
            world_SE3_ego_at_image=at_image,
        )

    def points_ego(self, name: str) -> NDArray[np.floating]:
        """See PosedSource."""
        log, sweep, _, _ = self._find(name)
        return self._points(log.folder / "sensors" / "lidar" / f"{sweep}.feather")

    def encoded_image(self, name: str) -> tuple[bytes, str]:
        """See PosedSource."""
        log, _, camera, taken = self._find(name)
        folder = log.folder / "sensors" / "cameras" / camera
        found = FolderFiles(folder, image.SUFFIXES).read(str(taken))
        if found is None:
            raise DatasetError(str(folder), f"there is no image {taken}.", "Add it.")
        return found[1], str(found[0])

    def ego_objects(self, labels: str, name: str) -> tuple[EgoObject, ...]:
        """See PosedSource."""
        log, sweep, _, _ = self._find(name)
        if labels != ANNOTATIONS or not (log.folder / "annotations.feather").is_file():
            raise DatasetError(str(log.folder), "the log has no annotations.", "Give a folder of labels.")
        return log.annotations.get(sweep, ())

    def _read_points(self, path: AnyPath) -> NDArray[np.float32]:
        try:
            table = read_table(path, ("x", "y", "z"))
        except FileNotFoundError:
            raise NoLidarError(str(path), "the sweep is not there.", "Add it, or skip the frame.") from None
        points: NDArray[np.float32] = np.column_stack(
            [table.column(axis).to_numpy().astype(np.float32) for axis in "xyz"]
        )
        points = points[np.isfinite(points).all(axis=1)]
        if not len(points):
            raise PointCloudError(str(path), "the sweep has no finite point.", "Skip the frame.")
        return points

    def _find(self, name: str) -> tuple[_Log, int, str, int]:
        """The log, the sweep's time, the camera and its image's time."""
        log_name, _, rest = name.partition("_")
        time, _, camera = rest.partition("_")
        log = self._logs.get(log_name)
        if log is not None and time.isdigit() and (taken := log.image_time(camera, int(time))) is not None:
            return log, int(time), camera, taken
        raise self._no_frame(name)


def recognise(root: AnyPath) -> Argoverse2 | None:
    """A log, a split of logs, or the folder of the splits."""
    if not is_folder(root):
        return None
    if _is_log(root):
        return Argoverse2(root, [root])
    folders = sorted(each for each in root.iterdir() if is_folder(each))
    logs = [each for each in folders if _is_log(each)]
    for split in folders if not logs else []:
        if split.name in ("train", "val", "test"):
            logs += sorted(each for each in split.iterdir() if is_folder(each) and _is_log(each))
    return Argoverse2(root, logs) if logs else None


def _is_log(folder: AnyPath) -> bool:
    return is_folder(folder / "sensors" / "lidar") and is_folder(folder / "calibration")


def _times(folder: AnyPath, suffixes: tuple[str, ...]) -> list[int]:
    if not is_folder(folder):
        return []
    return sorted(
        int(each.stem) for each in folder.iterdir() if each.suffix in suffixes and each.stem.isdigit()
    )


def _transforms(table: dict[str, list[Any]]) -> list[Floats]:
    quaternions = np.array([table[key] for key in _QUATERNION], dtype=np.float64).T
    translations = np.array([table[key] for key in _TRANSLATION], dtype=np.float64).T
    rotations = rotation_of(quaternions)
    return [pose(turn, shift) for turn, shift in zip(rotations, translations, strict=True)]
