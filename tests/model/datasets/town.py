"""A generated sweep that several cameras see, for other layouts, and what a reader must find in it."""

from __future__ import annotations

import io
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from boxlift.boxes import wrap_angle
from boxlift.camera import Floats
from boxlift.datasets.generated import KITTI_RIG, GeneratedFrame, Rig, generate
from boxlift.formats.ego_boxes import ego_objects_of_kitti
from boxlift.formats.kitti_label import KittiObject
from boxlift.frame import Frame
from boxlift.poses import inverse
from boxlift.sweep import EgoObject

SEED = 3
FRONT, LEFT = "front", "left"
_YAW_DEG = {FRONT: 0.0, LEFT: 40.0}


@dataclass(frozen=True)
class Town:
    """One sweep. cameras: what each saw of it. objects: all that either has in its truth, LiDAR frame."""

    points_velo: NDArray[np.float32]
    cameras: dict[str, GeneratedFrame]
    objects: tuple[EgoObject, ...]

    def velo_SE3_cam(self, camera: str) -> Floats:
        """(4, 4) where a camera is."""
        return inverse(self.cameras[camera].frame.calibration.cam_SE3_velo)

    def png(self, camera: str) -> bytes:
        """What a camera saw, as a file."""
        buffer = io.BytesIO()
        pixels = self.cameras[camera].frame.image
        assert pixels is not None
        Image.fromarray(pixels).save(buffer, "PNG")
        return buffer.getvalue()


@cache
def town(seed: int = SEED) -> Town:
    """The sweep of a seed, the same object each time: not to be changed."""
    return _town(seed, KITTI_RIG)


@cache
def pinhole_town(seed: int = SEED) -> Town:
    """The same through cameras whose projection has no fourth column, as outside KITTI."""
    rig = replace(KITTI_RIG, projection_offset=(0.0, 0.0, 0.0), rectification_deg=(0.0, 0.0, 0.0))
    return _town(seed, rig)


def _town(seed: int, rig: Rig) -> Town:
    cameras = {name: generate(seed, rig.turned(yaw, name)) for name, yaw in _YAW_DEG.items()}
    objects: list[EgoObject] = []
    for generated in cameras.values():
        mount = inverse(generated.frame.calibration.cam_SE3_velo)
        for each in ego_objects_of_kitti(generated.truth, mount):
            if all(np.linalg.norm(each.center_ego - other.center_ego) > 0.1 for other in objects):
                objects.append(each)
    return Town(cameras[FRONT].frame.points_velo, cameras, tuple(objects))


def require_same_view(frame: Frame, generated: GeneratedFrame, within_m: float = 1e-3) -> None:
    """The reader's points and calibration put every return where it was, in camera and image."""
    expected = generated.frame
    assert frame.image_size_px == expected.image_size_px
    assert len(frame.points_velo) == len(expected.points_velo)
    found_cam = frame.calibration.velo_to_cam(frame.points_velo)
    true_cam = expected.calibration.velo_to_cam(expected.points_velo)
    assert np.abs(found_cam - true_cam).max() < within_m
    ahead = true_cam[:, 2] > 5
    found_px, _ = frame.calibration.project(true_cam[ahead])
    true_px, _ = expected.calibration.project(true_cam[ahead])
    assert np.abs(found_px - true_px).max() < 1e-3
    if frame.image is not None:
        assert expected.image is not None
        assert np.array_equal(frame.image, expected.image)


def require_objects(found: list[KittiObject], generated: GeneratedFrame, within_m: float = 0.02) -> None:
    """Everything in the truth is found, where it is and as it stands; more may be."""
    truth = [each for each in generated.truth if each.has_box3d]
    assert truth
    for each in truth:
        gaps = [np.subtract(other.bottom_center_cam, each.bottom_center_cam) for other in found]
        nearest = found[int(np.argmin([np.linalg.norm(gap) for gap in gaps]))]
        assert np.allclose(nearest.bottom_center_cam, each.bottom_center_cam, atol=within_m)
        assert np.allclose(nearest.size_hwl_m, each.size_hwl_m, atol=0.011)
        turn = wrap_angle(np.array(nearest.rotation_y - each.rotation_y))
        assert abs(float(turn)) < 0.02
