"""Points and images of sweeps, in the ego frame, for formats that hold them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from boxlift.datasets import FrameSource
from boxlift.errors import InputError
from boxlift.sweep import CameraImage, SweepSensors
from boxlift_client.job import view_of


def sensors_of(source: FrameSource, frames: Iterable[str]) -> SweepSensors | None:
    """Those of a sweep from its frames; None where a file of it cannot be read."""
    points, images = None, []
    try:
        for name in frames:
            frame = source.load(name, with_image=True)
            view = view_of(frame)
            ego_SE3_velo = view.ego_SE3_cam @ frame.calibration.cam_SE3_velo
            xyz = frame.points_velo[:, :3] @ ego_SE3_velo[:3, :3].T + ego_SE3_velo[:3, 3]
            points = xyz.astype(np.float32)
            if frame.image is not None:
                image_P_cam = frame.calibration.image_P_cam
                images.append(CameraImage(view.camera, view.ego_SE3_cam, image_P_cam, frame.image))
    except InputError:
        return None
    return None if points is None else SweepSensors(points, tuple(images))
