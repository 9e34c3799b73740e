"""Labels as an MCAP recording for Foxglove: cubes and their texts as SceneUpdates, one message a sweep.

The metadata of a scene name its sweep and the tracks of its cubes, in their order ("-" for none).

Cubes stand in the frame "base_link", the ego frame; where poses are known, transforms place it in "map".
Beside them go the points and images of the sweep, where they are at hand. Times are the sweeps'; where those
are not known, sweeps are a tenth of a second apart. Source: Foxglove's schemas, through its SDK.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from boxlift.errors import MissingExtraError
from boxlift.formats.image import encoded_png
from boxlift.poses import Floats, quaternion_of
from boxlift.storage import writing_whole
from boxlift.sweep import CameraImage, EgoObject, SweepLabels, SweepSensors

if TYPE_CHECKING:
    from boxlift.storage import AnyPath

EGO, WORLD = "base_link", "map"
LABELS_TOPIC = "/boxlift/labels"
_UNKNOWN_STEP_NS = 100_000_000
_COLORS = {
    "Car": (0.18, 0.53, 0.87),
    "Van": (0.09, 0.63, 0.52),
    "Truck": (0.56, 0.27, 0.68),
    "Pedestrian": (0.9, 0.49, 0.13),
    "Cyclist": (0.15, 0.68, 0.38),
}
_OTHER_COLOR = (0.5, 0.55, 0.55)


def write_scene(sweeps: Iterable[tuple[SweepLabels, SweepSensors | None]], path: AnyPath) -> int:
    """Sweeps in the order of their times -> a recording, and how many boxes it has.

    Raises MissingExtraError without foxglove-sdk, OSError.
    """
    try:
        import foxglove
        from foxglove import channels
    except ImportError:
        raise MissingExtraError("foxglove-sdk", "formats") from None
    count = 0
    context = foxglove.Context()
    boxes = channels.SceneUpdateChannel(LABELS_TOPIC, context=context)
    transforms = channels.FrameTransformsChannel("/tf", context=context)
    clouds = channels.PointCloudChannel("/boxlift/points", context=context)
    cameras: dict[str, tuple[Any, Any]] = {}
    with writing_whole(path) as file, foxglove.open_mcap(file, context=context):
        for place, (labels, sensors) in enumerate(sweeps):
            time_ns = (1 + place) * _UNKNOWN_STEP_NS if labels.timestamp_ns is None else labels.timestamp_ns
            poses = {} if labels.world_SE3_ego is None else {(WORLD, EGO): labels.world_SE3_ego}
            for image in () if sensors is None else sensors.images:
                if image.camera not in cameras:
                    cameras[image.camera] = (
                        channels.CompressedImageChannel(f"/boxlift/{image.camera}/image", context=context),
                        channels.CameraCalibrationChannel(f"/boxlift/{image.camera}/info", context=context),
                    )
                poses[EGO, _optical(image)] = image.ego_SE3_cam
                pictures, calibrations = cameras[image.camera]
                calibrations.log(_calibration(image, time_ns), log_time=time_ns)
                pictures.log(_picture(image, time_ns), log_time=time_ns)
            if poses:
                transforms.log(_transforms(poses, time_ns), log_time=time_ns)
            if sensors is not None:
                clouds.log(_cloud(sensors, time_ns), log_time=time_ns)
            boxes.log(_scene(labels, time_ns), log_time=time_ns)
            count += len(labels.objects)
    return count


def _scene(labels: SweepLabels, time_ns: int) -> Any:
    """All boxes of a sweep in place of those of the one before."""
    from foxglove import messages

    cubes, texts = [], []
    for each in labels.objects:
        red, green, blue = _COLORS.get(each.category, _OTHER_COLOR)
        # The surer, the more opaque.
        color = messages.Color(r=red, g=green, b=blue, a=0.25 + 0.5 * min(max(each.score, 0.0), 1.0))
        size = messages.Vector3(x=each.length_m, y=each.width_m, z=each.height_m)
        cubes.append(messages.CubePrimitive(pose=_pose(each), size=size, color=color))
        above = replace(each, center_ego=each.center_ego + np.array([0, 0, each.height_m / 2 + 0.3]))
        texts.append(
            messages.TextPrimitive(pose=_pose(above), billboard=True, font_size=0.5, text=each.caption)
        )
    entity = messages.SceneEntity(
        timestamp=_stamp(time_ns),
        frame_id=EGO,
        id="labels",
        frame_locked=True,
        metadata=[
            messages.KeyValuePair(key="sweep", value=labels.sweep),
            messages.KeyValuePair(
                key="tracks", value=" ".join(each.track_id or "-" for each in labels.objects)
            ),
        ],
        cubes=cubes,
        texts=texts,
    )
    return messages.SceneUpdate(entities=[entity])


def _transforms(poses: dict[tuple[str, str], Floats], time_ns: int) -> Any:
    from foxglove import messages

    return messages.FrameTransforms(
        transforms=[
            messages.FrameTransform(
                timestamp=_stamp(time_ns),
                parent_frame_id=parent,
                child_frame_id=child,
                translation=_vector(matrix[:3, 3]),
                rotation=_quaternion(matrix[:3, :3]),
            )
            for (parent, child), matrix in poses.items()
        ]
    )


def _cloud(sensors: SweepSensors, time_ns: int) -> Any:
    from foxglove import messages

    xyz = np.ascontiguousarray(sensors.points_ego[:, :3], dtype="<f4")
    kind = messages.PackedElementFieldNumericType.Float32
    fields = [messages.PackedElementField(name=n, offset=4 * i, type=kind) for i, n in enumerate("xyz")]
    return messages.PointCloud(
        timestamp=_stamp(time_ns), frame_id=EGO, point_stride=12, fields=fields, data=xyz.tobytes()
    )


def _picture(image: CameraImage, time_ns: int) -> Any:
    from foxglove import messages

    return messages.CompressedImage(
        timestamp=_stamp(time_ns), frame_id=_optical(image), data=encoded_png(image.image), format="png"
    )


def _calibration(image: CameraImage, time_ns: int) -> Any:
    from foxglove import messages

    height, width = image.image.shape[:2]
    return messages.CameraCalibration(
        timestamp=_stamp(time_ns),
        frame_id=_optical(image),
        width=width,
        height=height,
        K=image.image_P_cam[:, :3].ravel().tolist(),
        R=np.eye(3).ravel().tolist(),
        P=image.image_P_cam.ravel().tolist(),
    )


def _optical(image: CameraImage) -> str:
    return f"{image.camera}_optical"


def _pose(each: EgoObject) -> Any:
    from foxglove import messages

    return messages.Pose(position=_vector(each.center_ego), orientation=_quaternion(each.ego_SO3_object))


def _vector(values: Floats) -> Any:
    from foxglove import messages

    x, y, z = (float(value) for value in values)
    return messages.Vector3(x=x, y=y, z=z)


def _quaternion(rotation: Floats) -> Any:
    from foxglove import messages

    w, x, y, z = quaternion_of(rotation)
    return messages.Quaternion(x=x, y=y, z=z, w=w)


def _stamp(time_ns: int) -> Any:
    from foxglove import messages

    return messages.Timestamp(sec=time_ns // 1_000_000_000, nsec=time_ns % 1_000_000_000)
