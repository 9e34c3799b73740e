"""Labels as a recording of Rerun (.rrd): boxes, points and images along a timeline of sweeps.

Entities: ego (boxes under ego/labels, points under ego/points, cameras under ego/CAMERA), placed in the world
where poses are known. Timelines: "sweep", the place in the order given, and "time" where it is known.
Source: Rerun's types, through its SDK.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from boxlift.errors import MissingExtraError
from boxlift.poses import Floats, quaternion_of
from boxlift.storage import writing_whole
from boxlift.sweep import CameraImage, SweepLabels, SweepSensors

if TYPE_CHECKING:
    from boxlift.storage import AnyPath


def write_recording(
    sweeps: Iterable[tuple[SweepLabels, SweepSensors | None]], path: AnyPath, name: str = "boxlift"
) -> int:
    """Sweeps in the order of their times -> a recording, and how many boxes it has.

    Raises MissingExtraError without rerun-sdk, OSError.
    """
    try:
        import rerun
    except ImportError:
        raise MissingExtraError("rerun-sdk", "rerun") from None
    count = 0
    with tempfile.TemporaryDirectory() as folder:
        written = Path(folder) / "labels.rrd"
        recording = rerun.RecordingStream("boxlift", recording_id=name)
        recording.save(written)
        recording.log("ego", rerun.ViewCoordinates.FLU, static=True)
        for number, (labels, sensors) in enumerate(sweeps):
            recording.set_time("sweep", sequence=number)
            if labels.timestamp_ns is not None:
                recording.set_time("time", timestamp=labels.timestamp_ns * 1e-9)
            if labels.world_SE3_ego is not None:
                recording.log("ego", _transform(rerun, labels.world_SE3_ego))
            recording.log("ego/labels", _boxes(rerun, labels))
            if sensors is not None:
                recording.log("ego/points", rerun.Points3D(sensors.points_ego[:, :3], radii=0.02))
                for image in sensors.images:
                    pixels = rerun.Image(image.image).compress(jpeg_quality=90)
                    place = _transform(rerun, image.ego_SE3_cam)
                    recording.log(f"ego/{image.camera}", place, _pinhole(rerun, image), pixels)
            count += len(labels.objects)
        recording.flush()
        recording.disconnect()
        with writing_whole(path) as file, written.open("rb") as source:
            shutil.copyfileobj(source, file)
    return count


def _boxes(rerun: Any, labels: SweepLabels) -> Any:
    objects = labels.objects
    quaternions = [quaternion_of(each.ego_SO3_object) for each in objects]
    return rerun.Boxes3D(
        centers=[each.center_ego for each in objects],
        half_sizes=[(each.length_m / 2, each.width_m / 2, each.height_m / 2) for each in objects],
        quaternions=[rerun.Quaternion(xyzw=(x, y, z, w)) for w, x, y, z in quaternions],
        labels=[each.caption for each in objects],
    )


def _transform(rerun: Any, parent_SE3_child: Floats) -> Any:
    return rerun.Transform3D(translation=parent_SE3_child[:3, 3], mat3x3=parent_SE3_child[:3, :3])


def _pinhole(rerun: Any, image: CameraImage) -> Any:
    height, width = image.image.shape[:2]
    return rerun.Pinhole(
        image_from_camera=image.image_P_cam[:, :3],
        resolution=(width, height),
        camera_xyz=rerun.ViewCoordinates.RDF,
    )
