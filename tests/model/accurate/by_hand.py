"""Boxes as rows of seven numbers and views without a ground fit, for tests that place every point."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from boxlift import Calibration, Frame, Prompt
from boxlift.accurate.parameters import project_edges
from boxlift.accurate.view import View
from boxlift.camera import Floats
from boxlift.ground import Ground, GroundPlane
from model.small_frame import CALIBRATION, CAMERA_HEIGHT_M, IMAGE_SIZE_PX

LEVEL = GroundPlane(np.array([0.0, -1.0, 0.0]), CAMERA_HEIGHT_M)
LWH_M = np.array([4.0, 1.7, 1.5])


def a_box(x: float = 2.0, z: float = 15.0, yaw: float = -1.2) -> Floats:
    """(1, 7) a car on the ground."""
    return np.array([[x, z, yaw, *LWH_M, CAMERA_HEIGHT_M]])


def outline_points(box: Floats, per_side: int = 20) -> Floats:
    """(2 * per_side, 2) x, z on the two sides of a box (1, 7) that face the camera."""
    x, z, yaw, length, width, _, _ = box[0]
    heading, left = np.array([np.cos(yaw), -np.sin(yaw)]), np.array([np.sin(yaw), np.cos(yaw)])
    center = np.array([x, z])
    share = np.linspace(-0.49, 0.49, per_side)[:, None]
    end = -np.sign(heading @ center) * heading * length / 2 + share * left * width
    side = -np.sign(left @ center) * left * width / 2 + share * heading * length
    outline: Floats = center + np.concatenate([end, side])
    return outline


def upright(points_xz: Floats, heights_m: Sequence[float] = (0.4, 0.7, 1.0)) -> Floats:
    """(M * H, 3) each of the points (M, 2) at each of the heights above the level ground."""
    return np.concatenate(
        [np.insert(points_xz, 1, CAMERA_HEIGHT_M - height, axis=1) for height in heights_m], axis=0
    )


def prompt_of(box: Floats, category: str = "Car") -> Prompt:
    """The exact prompt of a box (1, 7), cut to the image."""
    width, height = IMAGE_SIZE_PX
    edges = project_edges(box, CALIBRATION.image_P_cam)[0][0].clip(
        0, (width - 1, height - 1, width - 1, height - 1)
    )
    x1, y1, x2, y2 = edges.tolist()
    return Prompt(category, (x1, y1, x2, y2))


def view_of(
    points_cam: Floats, prompts: Sequence[Prompt] = (), calibration: Calibration = CALIBRATION
) -> View:
    """All of the points (N, 3), over level ground that needs no fit."""
    frame = Frame("by_hand", calibration.cam_to_velo(points_cam), calibration, IMAGE_SIZE_PX, tuple(prompts))
    ground = Ground(np.zeros(len(points_cam), dtype=np.bool_), LEVEL)
    pixels, _ = calibration.project(points_cam)
    return View(frame, ground, points_cam, pixels, LEVEL.height_above(points_cam))


def unclaimed(view: View) -> NDArray[np.bool_]:
    """(N,) no point is claimed."""
    return np.zeros(len(view.points_cam), dtype=np.bool_)
