"""A tiny frame that is built in: who labels it has every library loaded and working."""

from __future__ import annotations

import numpy as np

from boxlift.camera import Calibration
from boxlift.frame import Frame, Prompt
from boxlift.labeller import Labeller


def warm_up() -> None:
    """Label the built-in frame. Raises what the labeller raises, RuntimeError where its car gets no box."""
    (label,) = Labeller().label(_frame()).objects
    if label.box is None:
        raise RuntimeError(f"the built-in frame was not labelled: {label.sentence}")


def _frame() -> Frame:
    """A road, and of a car 15 m ahead the back and the right side (LiDAR frame: x forward, z up)."""
    ground_x, ground_y = np.meshgrid(np.linspace(5, 40, 60), np.linspace(-10, 10, 40))
    ground = np.stack([ground_x, ground_y, np.full_like(ground_x, -1.7)], axis=-1)
    across, up = np.meshgrid(np.linspace(-0.9, 0.9, 12), np.linspace(-1.4, -0.2, 10))
    back = np.stack([np.full_like(across, 15.0), across, up], axis=-1)
    along, up = np.meshgrid(np.linspace(15, 19, 20), np.linspace(-1.4, -0.2, 10))
    side = np.stack([along, np.full_like(along, -0.9), up], axis=-1)
    points_velo = np.concatenate([part.reshape(-1, 3) for part in (ground, back, side)])
    image_P_cam = np.array([[700.0, 0, 600, 0], [0, 700, 180, 0], [0, 0, 1, 0]])
    cam_SE3_velo = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    car = Prompt("Car", (540.0, 180.0, 660.0, 260.0))
    return Frame("warm-up", points_velo, Calibration(image_P_cam, cam_SE3_velo), (1200, 360), (car,))
