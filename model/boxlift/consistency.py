"""2D-3D consistency: shift a fitted box until its projection agrees with its prompt.

The paper (section 4.1) adjusts y in this way after M3D-RPN (Brazil and Liu, ICCV 2019); the authors'
release also fits x and the height, by at most 0.3 m.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from boxlift.boxes import NEAR_PLANE_M, Boxes3D
from boxlift.camera import Calibration, Floats
from boxlift.settings import ConsistencySettings

# An edge of a prompt this close to the border of the image may be where the image cuts the object.
BORDER_PX = 2.0
# Edges are almost linear in a shift of decimetres: Gauss-Newton settles in two or three steps.
_STEPS = 6
_DIFFERENCE_M = 1e-3
_SMALLEST_HEIGHT_M = 0.3


def cut_edges(boxes_px: Floats, image_size_px: tuple[int, int]) -> NDArray[np.bool_]:
    """(N, 4) which of the edges x1, y1, x2, y2 of 2D boxes (N, 4) the image border may cut."""
    width, height = image_size_px
    low = boxes_px[:, :2] <= BORDER_PX
    high = boxes_px[:, 2:] >= np.array([width, height]) - 1 - BORDER_PX
    return np.concatenate([low, high], axis=1)


def agree_with_prompts(
    boxes: Boxes3D,
    prompts_px: Floats,
    calibration: Calibration,
    image_size_px: tuple[int, int],
    settings: ConsistencySettings,
) -> Boxes3D:
    """Boxes whose y (and x, height, as set) bring the projected edges closest to the prompts (N, 4).

    Least squares in pixels over the edges that the image border does not cut. A box whose edges are all
    cut, or that reaches behind the camera, stays where it is.
    """
    names = [
        name
        for name, wanted in (
            ("x", settings.adjust_x),
            ("y", settings.adjust_y),
            ("height", settings.adjust_height),
        )
        if wanted
    ]
    if not names or len(boxes) == 0:
        return boxes
    usable = ~cut_edges(prompts_px, image_size_px)
    usable[:, [0, 2]] &= settings.adjust_x
    usable &= _before_camera(boxes, calibration)[:, None]
    limit = np.inf if settings.max_shift_m is None else settings.max_shift_m

    shift = np.zeros((len(boxes), len(names)))
    for _ in range(_STEPS):
        residual = _residual(boxes, names, shift, prompts_px, calibration, usable)
        jacobian = np.stack(
            [
                (_residual(boxes, names, shift + step, prompts_px, calibration, usable) - residual)
                / _DIFFERENCE_M
                for step in np.eye(len(names)) * _DIFFERENCE_M
            ],
            axis=-1,
        )
        # The ridge keeps a shift that no usable edge sees at zero; 1e-3 px per metre is next to nothing.
        normal = np.einsum("nep,neq->npq", jacobian, jacobian) + 1e-6 * np.eye(len(names))
        gradient = np.einsum("nep,ne->np", jacobian, residual)
        shift = (shift - np.linalg.solve(normal, gradient[..., None])[..., 0]).clip(-limit, limit)
    return _shifted(boxes, names, shift)


def _before_camera(boxes: Boxes3D, calibration: Calibration) -> NDArray[np.bool_]:
    """(N,) whether all of a box lies before the camera; a shift along x or y does not change that."""
    corners = boxes.corners()
    _, depth_m = calibration.project(corners)
    before: NDArray[np.bool_] = np.minimum(corners[..., 2], depth_m).min(axis=1) > NEAR_PLANE_M
    return before


def _residual(
    boxes: Boxes3D,
    names: list[str],
    shift: Floats,
    prompts_px: Floats,
    calibration: Calibration,
    usable: NDArray[np.bool_],
) -> Floats:
    edges_px = _shifted(boxes, names, shift).project(calibration)
    return np.where(usable, edges_px - prompts_px, 0.0)


def _shifted(boxes: Boxes3D, names: list[str], shift: Floats) -> Boxes3D:
    by_name = dict(zip(names, shift.T, strict=True))
    center = boxes.center_cam.copy()
    center[:, 0] += by_name.get("x", 0.0)
    center[:, 1] += by_name.get("y", 0.0)
    height = (boxes.height_m + by_name.get("height", 0.0)).clip(_SMALLEST_HEIGHT_M)
    return replace(boxes, center_cam=center, height_m=height)
