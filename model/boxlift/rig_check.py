"""Does the calibration agree with the data? A matrix can be valid and still be of another rig.

No check here needs an image or a label: the camera stands upright over the ground, some points are in its
view, and 2D boxes hold points where objects of their classes would be (see box_evidence). All thresholds
are ours; `benchmarks/rig_check.py` measures false alarms and what is noticed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxlift.box_evidence import judge_boxes
from boxlift.camera import Calibration, Floats
from boxlift.frame import Frame, FrameWarning, RigDoubt
from boxlift.priors import SizePrior
from boxlift.seeds import seed_of

# Fewer points than this say nothing about a rig.
_ENOUGH_POINTS = 200
# How far the image's sides may be from twice the principal point before it is another image's, and how
# alike the two factors then are: a cut moves the centre too, but hardly by the same factor on both axes.
_LARGEST_SCALE, _SAME_SCALE = 1.3, 1.25
_FIELD_OF_VIEW_DEG = (3.0, 150.0)
# Longer than a lorry with its trailer (18.75 m, Directive 96/53/EC).
_LARGEST_DISTANCE_M = 20.0
# Where the ground leans more, the labeller finds none (GroundSettings.max_tilt_deg) and boxes would lean.
_LARGEST_TILT_DEG = 16.0
# Without ground the LiDAR's own z axis, which is up, has to do, and LiDARs may be mounted at an angle.
_LARGEST_MOUNTING_TILT_DEG = 48.0
_CAMERA_HEIGHT_M = (0.2, 12.0)
# A lens of 10 degrees still sees 0.8 % of a turn of a 64-beam LiDAR.
_LEAST_SHARE_IN_VIEW = 0.002
# x_cam = -y_velo, y_cam = -z_velo, z_cam = x_velo.
_CAM_AXES_OF_VELO = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


def check_rig(frame: Frame, sizes: Mapping[str, SizePrior]) -> tuple[FrameWarning, ...]:
    """What the data of a frame say against its calibration; nothing for a rig that is right.

    `sizes` tells how far away an object of a class is that is so many pixels tall. What the mounting of
    camera and LiDAR explains is not said again of view and boxes.
    """
    camera = list(camera_doubts(frame.calibration, frame.image_size_px))
    prompts = list(_prompt_doubts(frame))
    if len(frame.points_velo) < _ENOUGH_POINTS:
        return (*camera, *prompts)
    mounting = list(_mounting_doubts(frame))
    if mounting:
        return (*camera, *mounting)
    boxes = judge_boxes(frame, sizes)
    if boxes.confirms:
        # It was a part of the image that was cut out, and its projection with it.
        camera = [warning for warning in camera if warning.doubt is not RigDoubt.IMAGE_SIZE]
    if boxes.points_in_image < _LEAST_SHARE_IN_VIEW * len(frame.points_velo):
        seen, total = boxes.points_in_image, len(frame.points_velo)
        return (*camera, *prompts, _doubt(RigDoubt.NOTHING_IN_VIEW, seen=seen, total=total))
    if boxes.contradicts:
        empty = boxes.judged - boxes.holding
        prompts.append(_doubt(RigDoubt.PROMPTS_WITHOUT_OBJECTS, empty=empty, total=boxes.judged))
    return (*camera, *prompts)


def _doubt(doubt: RigDoubt, **values: float | str) -> FrameWarning:
    return FrameWarning(doubt, doubt.value.format(**values))


def camera_doubts(calibration: Calibration, image_size_px: tuple[int, int]) -> Iterator[FrameWarning]:
    """Is the projection one of an image of this size (width, height)?"""
    width, height = image_size_px
    (focal_x, focal_y), (center_x, center_y) = calibration.focal_px, calibration.image_P_cam[:2, 2]
    view_deg = 2 * np.rad2deg(np.arctan2(width / 2, focal_x))
    narrowest, widest = _FIELD_OF_VIEW_DEG
    if not (narrowest < view_deg < widest and 0.5 * focal_x < focal_y < 2 * focal_x):
        yield _doubt(RigDoubt.FOCAL_LENGTH, fx=focal_x, fy=focal_y, view=view_deg, width=width)
        return
    small, large = sorted((2 * center_x / width, 2 * center_y / height))
    other_size = small > _LARGEST_SCALE or 0 < large < 1 / _LARGEST_SCALE
    if other_size and large < _SAME_SCALE * small:
        calibrated = f"{2 * center_x:.0f} x {2 * center_y:.0f}"
        yield _doubt(
            RigDoubt.IMAGE_SIZE, cx=center_x, cy=center_y, calibrated=calibrated, given=f"{width} x {height}"
        )


def _prompt_doubts(frame: Frame) -> Iterator[FrameWarning]:
    """Are the 2D boxes of this image?"""
    width, height = frame.image_size_px
    boxes = [prompt.box_px for prompt in frame.prompts]
    centers = [((x1 + x2) / 2, (y1 + y2) / 2) for x1, y1, x2, y2 in boxes if x1 < x2 and y1 < y2]
    outside = sum(not (0 <= x < width and 0 <= y < height) for x, y in centers)
    if outside >= 2 and 4 * outside >= len(centers):
        given = f"{width} x {height}"
        yield _doubt(RigDoubt.PROMPTS_OUTSIDE_IMAGE, outside=outside, total=len(centers), given=given)


def _mounting_doubts(frame: Frame) -> Iterator[FrameWarning]:
    """Do camera and LiDAR sit as on a vehicle, upright and over the ground?"""
    calibration = frame.calibration
    rotation = calibration.cam_SE3_velo[:3, :3]
    distance_m = float(np.linalg.norm(calibration.camera_center_cam - calibration.lidar_center_cam))
    if distance_m > _LARGEST_DISTANCE_M:
        yield _doubt(RigDoubt.LIDAR_FAR_AWAY, distance=distance_m)
    ground = find_ground_velo(frame.points_velo, frame.name)
    if ground is None:
        what, up_velo, largest_deg = "LiDAR", np.array([0.0, 0.0, 1.0]), _LARGEST_MOUNTING_TILT_DEG
    else:
        what, up_velo, largest_deg = "ground", ground.up, _LARGEST_TILT_DEG
    tilt_deg = _tilt_deg(rotation, up_velo)
    if tilt_deg > largest_deg:
        yield _doubt(RigDoubt.TILTED, what=what, tilt=tilt_deg, guess=_guess(rotation, up_velo))
    elif ground is not None:
        camera_velo = calibration.cam_to_velo(calibration.camera_center_cam[None])[0]
        height_m = float(ground.up @ (camera_velo - ground.point))
        if not _CAMERA_HEIGHT_M[0] < height_m < _CAMERA_HEIGHT_M[1]:
            yield _doubt(RigDoubt.CAMERA_HEIGHT, height=height_m)


def _tilt_deg(rotation: Floats, up_velo: Floats) -> float:
    """Angle between the direction that is up in the LiDAR frame and the camera's -y."""
    return float(np.rad2deg(np.arccos(np.clip(-(rotation @ up_velo)[1], -1, 1))))


def _guess(rotation: Floats, up_velo: Floats) -> str:
    """What might be wrong with a rotation that does not stand the camera upright."""
    if _tilt_deg(rotation.T, up_velo) < _LARGEST_TILT_DEG:
        return "Its transpose would stand upright: is it transposed, or the transform inverted?"
    if _tilt_deg(_CAM_AXES_OF_VELO @ rotation, up_velo) < _LARGEST_TILT_DEG:
        return "It leaves the LiDAR's axes as they are: turn x forward, y left, z up into the camera's."
    if _tilt_deg(-rotation, up_velo) < _LARGEST_TILT_DEG:
        return "It is upside down: turn image and calibration."
    return "Are degrees and radians mixed up, or is it another camera's?"


@dataclass(frozen=True)
class GroundVelo:
    """The ground around the LiDAR, in its frame: `up` (3,) its unit normal, `point` (3,) a point of it."""

    up: Floats
    point: Floats


def find_ground_velo(points_velo: NDArray[np.floating], frame_name: str) -> GroundVelo | None:
    """The plane that most of (N, 3+) points lie on and few below; None where none is clear.

    Only the LiDAR's own frame is used, in which z is roughly up, so that no calibration can be at fault.
    RANSAC by 128 triples of 2,000 points.
    """
    points = points_velo[:: max(1, len(points_velo) // 2000), :3].astype(np.float64)
    triples = points[np.random.default_rng(seed_of(frame_name)).integers(len(points), size=(128, 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    # Within 25 degrees of z: rigs lean and roads climb, walls do not.
    flat = np.abs(normals[:, 2]) > 0.9 * np.maximum(lengths, 1e-6)
    if not flat.any():
        return None
    up = normals[flat] / (lengths[flat] * np.sign(normals[flat, 2]))[:, None]
    heights_m = points @ up.T - (triples[flat, 0] * up).sum(axis=1)
    on, below = np.abs(heights_m) < 0.2, heights_m < -0.2
    best = int((on.sum(axis=0) - below.sum(axis=0)).argmax())
    share_on, share_below = on[:, best].mean(), below[:, best].mean()
    if share_on < 0.25 or share_below > 0.3 * (1 - share_on):
        return None
    around = points[on[:, best]]
    point = around.mean(axis=0)
    normal = np.linalg.eigh((around - point).T @ (around - point)).eigenvectors[:, 0]
    return GroundVelo(normal * np.sign(normal[2]), point)
