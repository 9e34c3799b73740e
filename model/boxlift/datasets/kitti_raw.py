"""KITTI raw: synchronised and rectified drives.

    ROOT/2011_09_26/calib_cam_to_cam.txt, calib_velo_to_cam.txt, calib_imu_to_velo.txt
    ROOT/2011_09_26/2011_09_26_drive_0005_sync/image_02/data/0000000003.png
                                              /velodyne_points/data/0000000003.bin, timestamps.txt
                                              /oxts/data/0000000003.txt        optional: poses
                                              /tracklet_labels.xml             optional: --prompts tracklets

ROOT, a day or one drive may be given. Frames are those of the left colour camera, image_02, and are called
2011_09_26_drive_0005_0000000003. The ego frame is the LiDAR's. Source: Geiger et al., IJRR 2013.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Calibration, Floats
from boxlift.datasets.folder_files import files_by_stem
from boxlift.datasets.posed_source import PosedSource, Shot
from boxlift.errors import CalibrationError, DatasetError, LabelFormatError, NoLidarError
from boxlift.formats import image, point_cloud
from boxlift.formats.calibration import parse_calibration
from boxlift.formats.oxts import imu_poses
from boxlift.formats.tracklets import read_tracklets
from boxlift.poses import inverse, pose
from boxlift.storage import is_folder, read_whole
from boxlift.sweep import EgoObject

if TYPE_CHECKING:
    from boxlift.storage import AnyPath

_DRIVE = re.compile(r"(\d{4}_\d\d_\d\d)_drive_(\d{4})_(sync|extract)")
_CAMERA = "image_02"
TRACKLETS = "tracklets"


@dataclass(frozen=True)
class _Drive:
    """One drive, read as far as it was asked for."""

    folder: AnyPath
    log: str

    @cached_property
    def points(self) -> dict[str, AnyPath]:
        return files_by_stem(self.folder / "velodyne_points" / "data", (".bin",))

    @cached_property
    def images(self) -> dict[str, AnyPath]:
        return files_by_stem(self.folder / _CAMERA / "data", image.SUFFIXES)

    @cached_property
    def stems(self) -> list[str]:
        return sorted(self.points.keys() | self.images.keys())

    @cached_property
    def calibration(self) -> Calibration:
        day = self.folder.parent
        camera = _text(day / "calib_cam_to_cam.txt")
        # R_rect_00, of the first camera, is what P_rect_02 asks for; the file has those of others too.
        keys = ("P_rect_02", "R_rect_00")
        lines = [line for line in camera.splitlines() if line.partition(":")[0] in keys]
        path = day / "calib_velo_to_cam.txt"
        transform = " ".join(f"{number:.12e}" for number in _transform(path)[:3].ravel())
        return parse_calibration("\n".join([*lines, f"Tr_velo_to_cam: {transform}"]), str(day)).calibration

    @cached_property
    def size_px(self) -> tuple[int, int]:
        path = self.folder.parent / "calib_cam_to_cam.txt"
        width, height = _numbers(path, "S_rect_02", 2)
        return int(width), int(height)

    @cached_property
    def poses(self) -> dict[str, Floats]:
        """start_SE3_velo by stem, where the drive has GPS/IMU records."""
        files = files_by_stem(self.folder / "oxts" / "data", (".txt",))
        if not files:
            return {}
        imu_SE3_velo = inverse(_transform(self.folder.parent / "calib_imu_to_velo.txt"))
        stems = sorted(files)
        records = imu_poses([_text(files[stem]) for stem in stems], str(self.folder / "oxts"))
        return {stem: each @ imu_SE3_velo for stem, each in zip(stems, records, strict=True)}

    @cached_property
    def timestamps(self) -> list[int]:
        """Nanoseconds by frame number; empty where the drive has none."""
        path = self.folder / "velodyne_points" / "timestamps.txt"
        return [_nanoseconds(line, path) for line in _text(path).splitlines()] if path.is_file() else []

    @cached_property
    def tracklets(self) -> dict[int, list[EgoObject]]:
        return read_tracklets(self.folder / "tracklet_labels.xml")


class KittiRaw(PosedSource):
    """FrameSource for drives of KITTI raw."""

    layout = "KITTI raw"

    def __init__(self, root: AnyPath, drives: list[AnyPath]) -> None:
        super().__init__(root)
        self._drives = {}
        for folder in drives:
            log = folder.name.removesuffix("_sync")
            self._drives[log] = _Drive(folder, log)
        if any((each.folder / "tracklet_labels.xml").is_file() for each in self._drives.values()):
            self.label_names = (TRACKLETS,)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all frames, sorted."""
        return tuple(f"{log}_{stem}" for log in sorted(self._drives) for stem in self._drives[log].stems)

    def shot(self, name: str) -> Shot:
        """See PosedSource."""
        drive, stem = self._find(name)
        number = int(stem)
        calibration = drive.calibration
        return Shot(
            sweep=name,
            log=drive.log,
            camera=_CAMERA,
            image_P_cam=calibration.image_P_cam,
            size_px=drive.size_px,
            mount_SE3_cam=inverse(calibration.cam_SE3_velo),
            lidar_origin_ego=np.zeros(3),
            timestamp_ns=drive.timestamps[number] if number < len(drive.timestamps) else None,
            world_SE3_ego=drive.poses.get(stem),
        )

    def points_ego(self, name: str) -> NDArray[np.floating]:
        """See PosedSource."""
        drive, stem = self._find(name)
        if stem not in drive.points:
            raise NoLidarError(
                str(drive.folder / "velodyne_points"),
                f"frame {name!r} has no LiDAR points.",
                f"Add data/{stem}.bin, or skip the frame.",
            )
        return point_cloud.read_points(drive.points[stem]).points

    def encoded_image(self, name: str) -> tuple[bytes, str]:
        """See PosedSource."""
        drive, stem = self._find(name)
        if stem not in drive.images:
            raise DatasetError(
                str(drive.folder / _CAMERA), f"frame {name!r} has no image.", f"Add data/{stem}.png."
            )
        return image.read_image(drive.images[stem]), str(drive.images[stem])

    def ego_objects(self, labels: str, name: str) -> list[EgoObject]:
        """See PosedSource."""
        drive, stem = self._find(name)
        if labels != TRACKLETS or not (drive.folder / "tracklet_labels.xml").is_file():
            raise DatasetError(str(drive.folder), "the drive has no tracklets.", "Add tracklet_labels.xml.")
        return drive.tracklets.get(int(stem), [])

    def _find(self, name: str) -> tuple[_Drive, str]:
        log, _, stem = name.rpartition("_")
        drive = self._drives.get(log)
        if drive is None or (stem not in drive.points and stem not in drive.images):
            raise self._no_frame(name)
        return drive, stem


def recognise(root: AnyPath) -> KittiRaw | None:
    """A drive, a day with drives, or a folder with such days. Raises DatasetError for drives as recorded."""
    if not is_folder(root):
        return None
    candidates = [root, *_folders(root)]
    candidates += [
        drive
        for day in candidates[1:]
        if re.fullmatch(r"\d{4}_\d\d_\d\d", day.name)
        for drive in _folders(day)
    ]
    found = [(folder, match) for folder in candidates if (match := _DRIVE.fullmatch(folder.name))]
    synchronised = [folder for folder, match in found if match.group(3) == "sync"]
    if found and not synchronised:
        raise DatasetError(
            str(found[0][0]),
            "the drive is not synchronised and its images are not rectified (extract).",
            "Give the drive that KITTI calls synced+rectified (sync).",
        )
    return KittiRaw(root, synchronised) if synchronised else None


def _folders(folder: AnyPath) -> list[AnyPath]:
    return sorted(each for each in folder.iterdir() if is_folder(each))


def _transform(path: AnyPath) -> Floats:
    """R and T of a file -> (4, 4). Raises CalibrationError, DatasetError."""
    return pose(_numbers(path, "R", 9).reshape(3, 3), _numbers(path, "T", 3))


def _numbers(path: AnyPath, key: str, count: int) -> Floats:
    lines = (line.partition(":") for line in _text(path).splitlines())
    words = next((words.split() for found, _, words in lines if found == key), [])
    try:
        return np.array(words, dtype=np.float64).reshape(count)
    except ValueError:
        raise CalibrationError(
            f"{path}.{key}",
            f"there is no line {key}: of {count} numbers.",
            "Give KITTI's calibration of the day.",
        ) from None


def _text(path: AnyPath) -> str:
    try:
        return read_whole(path).decode()
    except (OSError, UnicodeDecodeError) as error:
        problem = getattr(error, "strerror", None) or str(error)
        raise DatasetError(str(path), f"the file cannot be read ({problem}).", "Add it.") from None


def _nanoseconds(line: str, path: AnyPath) -> int:
    """2011-09-26 13:02:25.594360375 -> nanoseconds; KITTI does not say in which time zone."""
    whole, _, fraction = line.strip().partition(".")
    try:
        seconds = datetime.strptime(whole, "%Y-%m-%d %H:%M:%S").replace(tzinfo=UTC).timestamp()
        return int(seconds) * 1_000_000_000 + int(f"{fraction:0<9.9}")
    except ValueError:
        raise LabelFormatError(str(path), f"{line!r:.60} is no time.", "Give KITTI's timestamps.") from None
