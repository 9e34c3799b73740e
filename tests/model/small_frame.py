"""A frame made by hand: flat ground and the visible faces of boxes, for tests that need no ray caster."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from boxlift import Boxes3D, Calibration, Frame, Prompt
from boxlift.camera import Floats

IMAGE_SIZE_PX = (1242, 375)
CAMERA_HEIGHT_M = 1.65
CALIBRATION = Calibration(
    image_P_cam=np.array([[720.0, 0, 610, 0], [0, 720, 175, 0], [0, 0, 1, 0]]),
    cam_SE3_velo=np.array([[0.0, -1, 0, 0], [0, 0, -1, -0.08], [1, 0, 0, -0.27], [0, 0, 0, 1]]),
)


def car(x: float, z: float, rotation_y: float) -> Boxes3D:
    """A car of the frozen size on the ground."""
    one = np.ones(1)
    center = np.array([[x, CAMERA_HEIGHT_M - 0.8, z]])
    return Boxes3D(center, 4.0 * one, 1.8 * one, 1.6 * one, rotation_y * one)


def ground_points(rng: np.random.Generator, count: int = 6000) -> Floats:
    """Points (count, 3) of flat ground before the camera, rectified camera frame."""
    x, z = rng.uniform(-15, 15, count), rng.uniform(5, 45, count)
    return np.stack([x, np.full(count, CAMERA_HEIGHT_M), z], axis=1) + rng.normal(scale=0.02, size=(count, 3))


def face_points(box: Boxes3D, rng: np.random.Generator, count: int = 300) -> Floats:
    """Points (count, 3) on the two upright faces of a box that face the camera, 2 cm of noise."""
    length, width, height = box.length_m[0], box.width_m[0], box.height_m[0]
    cos, sin = np.cos(box.rotation_y[0]), np.sin(box.rotation_y[0])
    along, across = np.array([cos, 0, -sin]), np.array([sin, 0, cos])
    center = box.center_cam[0]
    end = -np.sign(along @ center) * along * length / 2
    side = -np.sign(across @ center) * across * width / 2
    share = rng.uniform(-0.5, 0.5, (count, 1))
    up = rng.uniform(-0.5, 0.35, (count, 1)) * height * np.array([0, -1.0, 0])
    on_end = rng.uniform(size=(count, 1)) < width / (length + width)
    faces = np.where(on_end, end + share * width * across, side + share * length * along)
    points: Floats = center + faces + up + rng.normal(scale=0.02, size=(count, 3))
    return points


def frame_of(
    cars: Sequence[Boxes3D],
    prompts: Sequence[Prompt] | None = None,
    name: str = "by_hand",
    ground_count: int = 6000,
) -> Frame:
    """A frame with these cars and, unless others are given, exact prompts for them."""
    rng = np.random.default_rng(0)
    points_cam = np.concatenate([ground_points(rng, ground_count), *(face_points(box, rng) for box in cars)])
    if prompts is None:
        width, height = IMAGE_SIZE_PX
        edges = [box.project(CALIBRATION)[0].clip(0, (width, height, width, height)) for box in cars]
        prompts = [Prompt("Car", (float(a), float(b), float(c), float(d))) for a, b, c, d in edges]
    return Frame(name, CALIBRATION.cam_to_velo(points_cam), CALIBRATION, IMAGE_SIZE_PX, tuple(prompts))
