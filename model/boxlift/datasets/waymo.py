"""Waymo Open Dataset, perception, in the Parquet files of its version 2.

    ROOT/training/COMPONENT/SEGMENT.parquet

with the components lidar, lidar_calibration, lidar_pose (optional), camera_image, camera_calibration,
vehicle_pose, and optionally lidar_box (--prompts lidar_box) and camera_box (--prompts camera_box, the 2D
boxes that people drew). ROOT or one split may be given. A frame is one camera's image of a sweep, called
SEGMENT_MICROSECONDS_FRONT. The ego frame is Waymo's vehicle frame. Points are the first returns of the LiDAR
on the roof, whose rays have one origin. Images are rectified; that their rows were exposed one after the
other is not made good. Source: Sun et al., CVPR 2020; waymo_open_dataset/v2 and utils/range_image_utils.py.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Floats
from boxlift.datasets.posed_source import PosedSource, Shot
from boxlift.datasets.waymo_range_image import points_of_range_image
from boxlift.errors import DatasetError, LabelFormatError, NoLidarError
from boxlift.formats.class_names import boxlift_class
from boxlift.formats.ego_boxes import LOOKING_AHEAD
from boxlift.formats.kitti_label import UNKNOWN_ANGLE, UNKNOWN_LOCATION, UNKNOWN_SIZE, KittiObject
from boxlift.formats.tables import read_table
from boxlift.lens import Lens
from boxlift.poses import about_z
from boxlift.storage import is_folder
from boxlift.sweep import EgoObject

if TYPE_CHECKING:
    from boxlift.storage import AnyPath

LIDAR_BOX, CAMERA_BOX = "lidar_box", "camera_box"
CAMERAS = {1: "FRONT", 2: "FRONT_LEFT", 3: "FRONT_RIGHT", 4: "SIDE_LEFT", 5: "SIDE_RIGHT"}
TOP_LASER = 1
_TYPES = {1: "Vehicle", 2: "Pedestrian", 3: "Sign", 4: "Cyclist"}
_NAME = re.compile(rf"(.+)_(\d+)_({'|'.join(CAMERAS.values())})")
_TIME, _CAMERA, _LASER = "key.frame_timestamp_micros", "key.camera_name", "key.laser_name"
_SPLITS = ("training", "validation", "testing")
# Of segments whose tables are kept: frames come in the order of their names.
_SEGMENTS_KEPT = 2

_Row = Mapping[str, Any]


class Waymo(PosedSource):
    """FrameSource for segments of the Waymo Open Dataset."""

    layout = "Waymo"

    def __init__(self, root: AnyPath, splits: list[AnyPath]) -> None:
        super().__init__(root)
        self._split_of = {
            path.stem: split
            for split in splits
            for path in (split / "lidar").iterdir()
            if path.suffix == ".parquet"
        }
        boxes = (LIDAR_BOX, CAMERA_BOX)
        self.label_names = tuple(each for each in boxes if any(is_folder(split / each) for split in splits))
        kept = lru_cache(maxsize=_SEGMENTS_KEPT)
        self._frames = kept(self._read_frames)
        self._cameras = kept(lambda segment: self._by_key(segment, "camera_calibration", _CAMERA))
        self._lasers = kept(lambda segment: self._by_key(segment, "lidar_calibration", _LASER))
        self._poses = kept(lambda segment: self._by_key(segment, "vehicle_pose", _TIME))
        self._poses_at_image = kept(self._read_poses_at_image)
        self._boxes = lru_cache(maxsize=2 * _SEGMENTS_KEPT)(self._read_boxes)
        self._points = lru_cache(maxsize=1)(self._read_points)  # the cameras of a sweep come in turn

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all frames, sorted."""
        return tuple(
            f"{segment}_{time}_{camera}"
            for segment in sorted(self._split_of)
            for time, camera in sorted(self._frames(segment))
        )

    def shot(self, name: str) -> Shot:
        """See PosedSource."""
        segment, time, number = self._find(name)
        camera = self._cameras(segment).get(number)
        if camera is None or time not in self._poses(segment):
            raise DatasetError(
                str(self._split_of[segment]),
                f"frame {name!r} has no calibration or no pose.",
                "Add camera_calibration and vehicle_pose of its segment.",
            )
        intrinsic = {
            key: float(camera[f"[CameraCalibrationComponent].intrinsic.{key}"])
            for key in ("f_u", "f_v", "c_u", "c_v", "k1", "k2", "p1", "p2", "k3")
        }
        image_P_cam = np.array(
            [
                [intrinsic["f_u"], 0, intrinsic["c_u"], 0],
                [0, intrinsic["f_v"], intrinsic["c_v"], 0],
                [0, 0, 1, 0],
            ]
        )
        distortion = [intrinsic[key] for key in ("k1", "k2", "p1", "p2", "k3")]
        laser = self._lasers(segment).get(TOP_LASER)
        return Shot(
            sweep=str(time),
            log=segment,
            camera=CAMERAS[number],
            image_P_cam=image_P_cam,
            size_px=(
                int(camera["[CameraCalibrationComponent].width"]),
                int(camera["[CameraCalibrationComponent].height"]),
            ),
            # Waymo's cameras have x ahead, y left, z up.
            mount_SE3_cam=_matrix(camera["[CameraCalibrationComponent].extrinsic.transform"]) @ LOOKING_AHEAD,
            lidar_origin_ego=np.zeros(3) if laser is None else _extrinsic(laser)[:3, 3],
            timestamp_ns=time * 1000,
            world_SE3_ego=_vehicle_pose(self._poses(segment)[time]),
            world_SE3_ego_at_image=self._poses_at_image(segment).get((time, number)),
            lens=Lens.of(image_P_cam, "plumb_bob", distortion),
        )

    def points_ego(self, name: str) -> NDArray[np.floating]:
        """See PosedSource."""
        segment, time, _ = self._find(name)
        return self._points(segment, time)

    def encoded_image(self, name: str) -> tuple[bytes, str]:
        """See PosedSource."""
        segment, time, number = self._find(name)
        column = "[CameraImageComponent].image"
        filters = [(_TIME, "==", time), (_CAMERA, "==", number)]
        table = read_table(self._path(segment, "camera_image"), (column,), filters)
        return table.column(column)[0].as_py(), name

    def ego_objects(self, labels: str, name: str) -> list[EgoObject]:
        """See PosedSource."""
        segment, time, _ = self._find(name)
        prefix = "[LiDARBoxComponent]."
        return [
            EgoObject(
                category=_TYPES.get(int(row[f"{prefix}type"]), "Unknown"),
                center_ego=np.array([row[f"{prefix}box.center.{axis}"] for axis in "xyz"], dtype=np.float64),
                ego_SO3_object=about_z(float(row[f"{prefix}box.heading"])),
                length_m=float(row[f"{prefix}box.size.x"]),
                width_m=float(row[f"{prefix}box.size.y"]),
                height_m=float(row[f"{prefix}box.size.z"]),
                track_id=str(row["key.laser_object_id"]),
                points=row.get(f"{prefix}num_lidar_points_in_box"),
                difficulty=row.get(f"{prefix}difficulty_level.detection") or None,
            )
            for row in self._labels(segment, labels, LIDAR_BOX).get(time, [])
        ]

    def objects(self, labels: str, name: str) -> list[KittiObject]:
        """See PosedSource; of camera_box there is no 3D box."""
        if labels != CAMERA_BOX:
            return super().objects(labels, name)
        segment, time, number = self._find(name)
        shot = self.shot(name)
        objects = []
        for row in self._labels(segment, labels, CAMERA_BOX).get(time, []):
            if int(row[_CAMERA]) != number:
                continue
            x, y, length, height = (
                float(row[f"[CameraBoxComponent].box.{key}"])
                for key in ("center.x", "center.y", "size.x", "size.y")
            )
            box_px = (x - length / 2, y - height / 2, x + length / 2, y + height / 2)
            if shot.lens is not None:
                box_px = shot.lens.rectified_box(box_px, shot.size_px)
            category = boxlift_class(_TYPES.get(int(row["[CameraBoxComponent].type"]), "Unknown"))
            unknown = (UNKNOWN_SIZE, UNKNOWN_LOCATION, UNKNOWN_ANGLE)
            objects.append(KittiObject(category, -1.0, -1, UNKNOWN_ANGLE, box_px, *unknown))
        return objects

    def _labels(self, segment: str, labels: str, component: str) -> dict[int, list[_Row]]:
        if labels != component or not self._path(segment, component, required=False).is_file():
            raise DatasetError(
                labels, f"segment {segment} has no such boxes.", f"Give {LIDAR_BOX} or a folder."
            )
        return self._boxes(segment, component)

    def _read_frames(self, segment: str) -> set[tuple[int, str]]:
        """(time, camera) of every image."""
        table = read_table(self._path(segment, "camera_image"), (_TIME, _CAMERA)).to_pydict()
        keys = zip(table[_TIME], table[_CAMERA], strict=True)
        return {(int(time), CAMERAS[int(number)]) for time, number in keys if int(number) in CAMERAS}

    def _read_poses_at_image(self, segment: str) -> dict[tuple[int, int], Floats]:
        column = "[CameraImageComponent].pose.transform"
        rows = read_table(self._path(segment, "camera_image"), (_TIME, _CAMERA, column)).to_pylist()
        return {(int(row[_TIME]), int(row[_CAMERA])): _matrix(row[column]) for row in rows}

    def _read_boxes(self, segment: str, component: str) -> dict[int, list[_Row]]:
        of_time: dict[int, list[_Row]] = {}
        for row in read_table(self._path(segment, component)).to_pylist():
            of_time.setdefault(int(row[_TIME]), []).append(row)
        return of_time

    def _read_points(self, segment: str, time: int) -> NDArray[np.float32]:
        filters = [(_TIME, "==", time), (_LASER, "==", TOP_LASER)]
        rows = self._range_image(segment, "lidar", "LiDARComponent", filters)
        laser = self._lasers(segment).get(TOP_LASER)
        if rows is None or laser is None:
            raise NoLidarError(
                str(self._split_of[segment]),
                f"sweep {time} of {segment} has no roof LiDAR.",
                "Skip the frame.",
            )
        poses = None
        if self._path(segment, "lidar_pose", required=False).is_file():
            poses = self._range_image(segment, "lidar_pose", "LiDARPoseComponent", filters)
        prefix = "[LiDARCalibrationComponent].beam_inclination."
        values = laser[f"{prefix}values"]
        limits = (laser[f"{prefix}min"], laser[f"{prefix}max"])
        return points_of_range_image(
            rows, values, limits, _extrinsic(laser), poses, _vehicle_pose(self._poses(segment)[time])
        )

    def _range_image(self, segment: str, component: str, title: str, filters: Any) -> Floats | None:
        """(H, W, channels) of the first return."""
        columns = [f"[{title}].range_image_return1.{key}" for key in ("values", "shape")]
        table = read_table(self._path(segment, component), columns, filters)
        if table.num_rows == 0:
            return None
        # Flat arrays: as Python lists a range image would take longer than its frame's labels.
        values, shape = (table.column(column).combine_chunks()[:1].flatten().to_numpy() for column in columns)
        try:
            return np.array(values, dtype=np.float64).reshape(tuple(int(side) for side in shape))
        except ValueError as error:
            raise LabelFormatError(
                str(self._path(segment, component)), f"a range image is cut off ({error}).", "Get it again."
            ) from None

    def _by_key(self, segment: str, component: str, key: str) -> dict[int, _Row]:
        rows = read_table(self._path(segment, component)).to_pylist()
        return {int(row[key]): row for row in rows}

    def _path(self, segment: str, component: str, *, required: bool = True) -> AnyPath:
        path = self._split_of[segment] / component / f"{segment}.parquet"
        if required and not path.is_file():
            raise DatasetError(str(path), "the file is not there.", f"Add the component {component}.")
        return path

    def _find(self, name: str) -> tuple[str, int, int]:
        """Segment, time, number of the camera."""
        match = _NAME.fullmatch(name)
        if match is None or match[1] not in self._split_of:
            raise self._no_frame(name)
        segment, time, camera = match[1], int(match[2]), match[3]
        if (time, camera) not in self._frames(segment):
            raise self._no_frame(name)
        return segment, time, next(number for number, each in CAMERAS.items() if each == camera)


def recognise(root: AnyPath) -> Waymo | None:
    """A split, or the folder of the splits: told by lidar/ with Parquet files beside camera_image/."""
    candidates = [root, *(root / split for split in _SPLITS)]
    splits = [each for each in candidates if is_folder(each / "lidar") and is_folder(each / "camera_image")]
    return Waymo(root, splits) if splits else None


def _matrix(values: Any) -> Floats:
    return np.array(values, dtype=np.float64).reshape(4, 4)


def _extrinsic(laser: _Row) -> Floats:
    return _matrix(laser["[LiDARCalibrationComponent].extrinsic.transform"])


def _vehicle_pose(row: _Row) -> Floats:
    return _matrix(row["[VehiclePoseComponent].world_from_vehicle.transform"])
