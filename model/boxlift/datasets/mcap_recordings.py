"""MCAP recordings with messages of Foxglove's schemas, encoded as protobuf.

    RECORDING.mcap, or a folder of them, with topics of
        foxglove.PointCloud           the LiDAR: of several topics the one with the most messages
        foxglove.CompressedImage      JPEG or PNG, one topic a camera
        foxglove.CameraCalibration    with the image's frame_id; the first message of each camera counts
        foxglove.FrameTransform(s)    how LiDAR and cameras are mounted, and where the vehicle is

A frame is the image of a camera nearest to a sweep (within 100 ms), called RECORDING_LOGTIME_TOPIC, where
TOPIC has dashes for slashes. The ego frame is base_link where the transforms know it, else the LiDAR's; the
world is map or odom. Images with distortion are rectified. Where the vehicle was is interpolated.
"""

from __future__ import annotations

import bisect
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Floats
from boxlift.datasets.posed_source import PosedSource, Shot
from boxlift.datasets.recording import Recording, timestamp_ns
from boxlift.datasets.transform_tree import TimedTransform, TransformTree
from boxlift.errors import CalibrationError, DatasetError, PointCloudError
from boxlift.lens import Lens
from boxlift.poses import pose, rotation_of

if TYPE_CHECKING:
    from boxlift.storage import AnyPath

SUFFIX = ".mcap"
POINTS, IMAGES = "foxglove.PointCloud", "foxglove.CompressedImage"
CALIBRATIONS = "foxglove.CameraCalibration"
_TRANSFORMS = ("foxglove.FrameTransform", "foxglove.FrameTransforms")
_EGO, _WORLDS = "base_link", ("map", "odom")
_LARGEST_GAP_NS = 100_000_000
# Transforms are looked for around a sweep, and in the beginning, where those that never change may be alone.
_AROUND_NS, _BEGINNING_NS = 500_000_000, 2_000_000_000
_LARGEST_COORDINATE_M = 1e5
# foxglove.PackedElementField.NumericType
_NUMERIC = {1: "u1", 2: "i1", 3: "<u2", 4: "<i2", 5: "<u4", 6: "<i4", 7: "<f4", 8: "<f8"}


class McapRecordings(PosedSource):
    """FrameSource for recordings."""

    layout = "MCAP"

    def __init__(self, root: AnyPath, files: list[AnyPath]) -> None:
        super().__init__(root)
        self._recordings = {path.stem: Recording(path) for path in files}
        self._sweep = lru_cache(maxsize=1)(self._read_sweep)  # the cameras of a sweep come in turn
        self._tree = lru_cache(maxsize=1)(self._read_tree)
        self._calibration = lru_cache(maxsize=64)(self._read_calibration)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all frames, sorted."""
        return tuple(
            f"{stem}_{time}_{camera_name(topic)}"
            for stem, recording in sorted(self._recordings.items())
            for time in self._sweeps(stem)
            for topic in sorted(recording.times.get(IMAGES, {}))
            if self._image_time(stem, topic, time) is not None
        )

    def shot(self, name: str) -> Shot:
        """See PosedSource."""
        stem, time, topic, image_time = self._find(name)
        recording = self._recordings[stem]
        cloud, seen = self._sweep(stem, time), recording.message(topic, image_time)
        scanned_at, seen_at = timestamp_ns(cloud, time), timestamp_ns(seen, image_time)
        tree = self._tree(stem, time)
        lidar = str(cloud.frame_id)
        ego = _EGO if tree.between(_EGO, lidar, scanned_at) is not None else lidar
        calibration = self._calibration(stem, str(seen.frame_id))
        mount = tree.between(ego, str(calibration.frame_id), seen_at)
        if mount is None:
            raise DatasetError(
                str(recording.path),
                f"no transforms lead from {calibration.frame_id} to {ego}.",
                "Record how the sensors are mounted (foxglove.FrameTransform).",
            )
        worlds = [each for each in _WORLDS if tree.between(each, ego, scanned_at) is not None]
        world = worlds[0] if worlds else ego
        image_P_cam, lens = _camera(calibration, f"{recording.path}:{topic}")
        return Shot(
            sweep=f"{stem}_{time}",
            log=stem,
            camera=camera_name(topic),
            image_P_cam=image_P_cam,
            size_px=(int(calibration.width), int(calibration.height)),
            mount_SE3_cam=mount,
            lidar_origin_ego=self._ego_SE3_cloud(stem, time, ego)[:3, 3],
            timestamp_ns=scanned_at,
            world_SE3_ego=tree.between(world, ego, scanned_at) if worlds else None,
            world_SE3_ego_at_image=tree.between(world, ego, seen_at) if worlds else None,
            lens=lens,
        )

    def points_ego(self, name: str) -> NDArray[np.floating]:
        """See PosedSource."""
        stem, time, _, _ = self._find(name)
        cloud = self._sweep(stem, time)
        points = points_of(cloud, f"{self._recordings[stem].path}:{time}")
        lidar, at = str(cloud.frame_id), timestamp_ns(cloud, time)
        ego = _EGO if self._tree(stem, time).between(_EGO, lidar, at) is not None else lidar
        mount = self._ego_SE3_cloud(stem, time, ego)
        return points @ mount[:3, :3].T + mount[:3, 3]

    def encoded_image(self, name: str) -> tuple[bytes, str]:
        """See PosedSource."""
        stem, _, topic, image_time = self._find(name)
        recording = self._recordings[stem]
        return bytes(recording.message(topic, image_time).data), f"{recording.path}:{topic}"

    def _ego_SE3_cloud(self, stem: str, time: int, ego: str) -> Floats:
        """From what the cloud's coordinates are in: its frame, and its own pose in that."""
        cloud = self._sweep(stem, time)
        mount = self._tree(stem, time).between(ego, str(cloud.frame_id), timestamp_ns(cloud, time))
        assert mount is not None
        if not cloud.HasField("pose"):
            return mount
        position, turn = cloud.pose.position, cloud.pose.orientation
        quaternion = np.array([[turn.w, turn.x, turn.y, turn.z]])
        rotation = rotation_of(quaternion)[0] if quaternion.any() else np.eye(3)
        return mount @ pose(rotation, np.array([position.x, position.y, position.z]))

    def _sweeps(self, stem: str) -> list[int]:
        lidar = self._lidar(stem)
        return self._recordings[stem].times[POINTS][lidar]

    def _lidar(self, stem: str) -> str:
        """Topic of the LiDAR."""
        recording = self._recordings[stem]
        topics = recording.times.get(POINTS)
        if not topics:
            others = ", ".join(recording.other_encodings[:5])
            raise DatasetError(
                str(recording.path),
                f"there is no topic of {POINTS} in protobuf" + (f" (but {others})." if others else "."),
                "Convert the recording to Foxglove's schemas.",
            )
        return min(topics, key=lambda topic: (-len(topics[topic]), topic))

    def _image_time(self, stem: str, topic: str, time: int) -> int | None:
        """Log time of the image nearest to a sweep; None where none is near."""
        times = self._recordings[stem].times.get(IMAGES, {}).get(topic, [])
        at = bisect.bisect(times, time)
        nearest = min(times[max(at - 1, 0) : at + 1], key=lambda each: abs(each - time), default=None)
        return nearest if nearest is not None and abs(nearest - time) <= _LARGEST_GAP_NS else None

    def _read_sweep(self, stem: str, time: int) -> Any:
        return self._recordings[stem].message(self._lidar(stem), time)

    def _read_tree(self, stem: str, time: int) -> TransformTree:
        recording = self._recordings[stem]
        times = {
            topic: each for schema in _TRANSFORMS for topic, each in recording.times.get(schema, {}).items()
        }
        if not times:
            return TransformTree([])
        begin = min(each[0] for each in times.values())
        spans = [(begin, begin + _BEGINNING_NS), (time - _AROUND_NS, time + _AROUND_NS)]
        return TransformTree(
            _timed(item, logged)
            for start, end in spans
            for _, logged, message in recording.messages(list(times), max(start, 0), end)
            for item in (message.transforms if hasattr(message, "transforms") else [message])
        )

    def _read_calibration(self, stem: str, frame_id: str) -> Any:
        recording = self._recordings[stem]
        for topic, times in sorted(recording.times.get(CALIBRATIONS, {}).items()):
            message = recording.message(topic, times[0])
            if message.frame_id == frame_id:
                return message
        raise CalibrationError(
            str(recording.path),
            f"there is no {CALIBRATIONS} for the frame {frame_id!r}.",
            "Record one with the frame_id of the images.",
        )

    def _find(self, name: str) -> tuple[str, int, str, int]:
        """Recording, log time of the sweep, topic and log time of the image."""
        for stem in self._recordings:
            time, _, camera = name.removeprefix(f"{stem}_").partition("_")
            if not name.startswith(f"{stem}_") or not time.isdigit():
                continue
            for topic in self._recordings[stem].times.get(IMAGES, {}):
                if camera_name(topic) == camera:
                    image_time = self._image_time(stem, topic, int(time))
                    if image_time is not None:
                        return stem, int(time), topic, image_time
        raise self._no_frame(name)


def recognise(root: AnyPath) -> McapRecordings | None:
    """A recording, or a folder of recordings."""
    if root.is_file():
        return McapRecordings(root.parent, [root]) if root.suffix == SUFFIX else None
    files = sorted(each for each in root.iterdir() if each.suffix == SUFFIX)
    return McapRecordings(root, files) if files else None


def camera_name(topic: str) -> str:
    """A topic as part of a file's name."""
    return topic.strip("/").replace("/", "-").replace(" ", "-")


def points_of(cloud: Any, where: str) -> Floats:
    """(N, 3) finite points of a foxglove.PointCloud, in its own coordinates. Raises PointCloudError."""
    fields = {field.name: field for field in cloud.fields}
    stride = int(cloud.point_stride)
    try:
        kinds = [_NUMERIC[fields[axis].type] for axis in "xyz"]
        offsets = [int(fields[axis].offset) for axis in "xyz"]
        layout = np.dtype({"names": list("xyz"), "formats": kinds, "offsets": offsets, "itemsize": stride})
        rows = np.frombuffer(cloud.data, dtype=layout)
    except (KeyError, ValueError) as error:
        raise PointCloudError(
            where, f"the cloud's fields do not fit its data ({error}).", "Give x, y and z."
        ) from None
    points = np.column_stack([rows[axis].astype(np.float64) for axis in "xyz"])
    with np.errstate(invalid="ignore"):
        usable = (np.abs(points) < _LARGEST_COORDINATE_M).all(axis=1)
    if not usable.any():
        raise PointCloudError(where, "the cloud has no finite point.", "Skip the sweep.")
    return np.asarray(points[usable])


def _camera(calibration: Any, where: str) -> tuple[Floats, Lens | None]:
    """Projection of the rectified camera, and what its images must be rectified from."""
    intrinsic = np.array(list(calibration.K), dtype=np.float64)
    if intrinsic.shape != (9,) or not intrinsic[0]:
        raise CalibrationError(f"{where}.K", "the camera is not calibrated.", "Give K, 9 numbers.")
    image_P_cam = np.column_stack([intrinsic.reshape(3, 3), np.zeros(3)])
    turn = np.array(list(calibration.R), dtype=np.float64)
    if turn.any() and not np.allclose(turn, np.eye(3).ravel(), atol=1e-6):
        raise CalibrationError(
            f"{where}.R",
            "a stereo rectification is not supported.",
            "Give the camera's own frame, without R.",
        )
    lens = Lens.of(image_P_cam, str(calibration.distortion_model), list(calibration.D))
    rectified = np.array(list(calibration.P), dtype=np.float64)
    if lens is None and rectified.shape == (12,) and rectified[0]:
        image_P_cam = rectified.reshape(3, 4)
    return image_P_cam, lens


def _timed(message: Any, logged: int) -> TimedTransform:
    shift, turn = message.translation, message.rotation
    quaternion = np.array([turn.w, turn.x, turn.y, turn.z])
    return TimedTransform(
        str(message.parent_frame_id),
        str(message.child_frame_id),
        timestamp_ns(message, logged),
        np.array([shift.x, shift.y, shift.z]),
        quaternion if quaternion.any() else np.array([1.0, 0, 0, 0]),
    )
