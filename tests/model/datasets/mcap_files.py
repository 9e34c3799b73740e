"""Writes a generated sweep as an MCAP recording, with Foxglove's own SDK."""

from __future__ import annotations

from pathlib import Path

import foxglove
import numpy as np
from foxglove import Context
from foxglove.channels import (
    CameraCalibrationChannel,
    CompressedImageChannel,
    FrameTransformsChannel,
    PointCloudChannel,
)
from foxglove.messages import (
    CameraCalibration,
    CompressedImage,
    FrameTransform,
    FrameTransforms,
    PackedElementField,
    PackedElementFieldNumericType,
    PointCloud,
    Pose,
    Quaternion,
    Timestamp,
    Vector3,
)

from boxlift.camera import Floats
from boxlift.poses import pose, quaternion_of
from model.datasets.town import FRONT, LEFT, Town
from model.datasets.vehicle import EGO_SE3_VELO, WORLD_SE3_EGO, WORLD_SE3_EGO_AT_IMAGE, mount_of

SWEEP_NS = 1_700_000_000_100_000_000
IMAGE_NS = SWEEP_NS + 40_000_000
TOPICS = {FRONT: "/camera/front/image", LEFT: "/camera/left/image"}


def write_recording(
    path: Path,
    scene: Town,
    *,
    vehicle: bool = True,
    distortion: tuple[float, ...] = (),
    model: str = "plumb_bob",
    sweeps: int = 1,
) -> None:
    """With `vehicle` there are base_link and map, and it moves; else sensors alone, told from the LiDAR."""
    context = Context()
    clouds = PointCloudChannel("/lidar/points", context=context)
    transforms = FrameTransformsChannel("/tf", context=context)
    with foxglove.open_mcap(path, context=context):
        if vehicle:
            static = {("base_link", "lidar"): EGO_SE3_VELO}
            static |= {("base_link", f"{each}_optical"): mount_of(scene, each) for each in scene.cameras}
        else:
            static = {("lidar", f"{each}_optical"): scene.velo_SE3_cam(each) for each in scene.cameras}
        transforms.log(_frames(static, SWEEP_NS - 90_000_000), log_time=SWEEP_NS - 90_000_000)
        if vehicle:
            # Before and after the moments that count, so that these are between.
            for at, place in ((SWEEP_NS, WORLD_SE3_EGO), (IMAGE_NS, WORLD_SE3_EGO_AT_IMAGE)):
                transforms.log(_frames({("map", "base_link"): place}, at), log_time=at)
        for camera, topic in TOPICS.items():
            rig = scene.cameras[camera].rig
            intrinsic = rig.projection[:, :3].ravel().tolist()
            calibration = CameraCalibration(
                timestamp=_stamp(SWEEP_NS),
                frame_id=f"{camera}_optical",
                width=rig.image_size_px[0],
                height=rig.image_size_px[1],
                distortion_model=model if distortion else "",
                D=list(distortion),
                K=intrinsic,
                R=np.eye(3).ravel().tolist(),
                P=rig.projection.ravel().tolist(),
            )
            CameraCalibrationChannel(f"/camera/{camera}/info", context=context).log(
                calibration, log_time=SWEEP_NS - 80_000_000
            )
            picture = CompressedImage(
                timestamp=_stamp(IMAGE_NS), frame_id=f"{camera}_optical", data=scene.png(camera), format="png"
            )
            channel = CompressedImageChannel(topic, context=context)
            channel.log(picture, log_time=IMAGE_NS + 1_000_000)
        for number in range(sweeps):
            # Half a second apart: only the first has images near it.
            at = SWEEP_NS + number * 500_000_000
            clouds.log(_cloud(scene, at), log_time=at + 2_000_000)


def _cloud(scene: Town, at: int) -> PointCloud:
    """Rows of intensity, x, y, z, shifted as the message's pose says, and one that is no return."""
    rows = np.empty((len(scene.points_velo) + 1, 4), dtype="<f4")
    rows[1:, 0], rows[1:, 1:] = scene.points_velo[:, 3], scene.points_velo[:, :3]
    rows[1:, 1] -= 0.5
    rows[0] = np.nan
    kind = PackedElementFieldNumericType.Float32
    fields = [
        PackedElementField(name=n, offset=4 * i, type=kind) for i, n in enumerate(("intensity", *"xyz"))
    ]
    return PointCloud(
        timestamp=_stamp(at),
        frame_id="lidar",
        pose=Pose(position=Vector3(x=0.5, y=0, z=0), orientation=Quaternion(x=0, y=0, z=0, w=1)),
        point_stride=16,
        fields=fields,
        data=rows.tobytes(),
    )


def _frames(transforms: dict[tuple[str, str], Floats], at: int) -> FrameTransforms:
    return FrameTransforms(
        transforms=[
            FrameTransform(
                timestamp=_stamp(at),
                parent_frame_id=parent,
                child_frame_id=child,
                translation=Vector3(x=matrix[0, 3], y=matrix[1, 3], z=matrix[2, 3]),
                rotation=_quaternion(matrix),
            )
            for (parent, child), matrix in transforms.items()
        ]
    )


def _quaternion(matrix: Floats) -> Quaternion:
    w, x, y, z = quaternion_of(pose(matrix[:3, :3], np.zeros(3))[:3, :3])
    return Quaternion(x=x, y=y, z=z, w=w)


def _stamp(time_ns: int) -> Timestamp:
    return Timestamp(sec=time_ns // 1_000_000_000, nsec=time_ns % 1_000_000_000)
