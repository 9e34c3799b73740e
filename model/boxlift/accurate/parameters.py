"""A box as seven numbers, as the polish moves it and the evidence weighs it; B boxes are (B, 7)."""

from __future__ import annotations

import numpy as np

from boxlift.boxes import Boxes3D
from boxlift.camera import Floats

# Columns. BOTTOM is the y of the bottom face (down is positive).
X, Z, YAW, LENGTH, WIDTH, HEIGHT, BOTTOM = range(7)
# Corners nearer than this before the camera are projected as if they were here.
_NEAREST_M = 0.3
_ALONG = np.array([1, -1, -1, 1]) / 2
_ACROSS = np.array([1, 1, -1, -1]) / 2


def to_boxes(parameters: Floats) -> Boxes3D:
    """(B, 7) -> B boxes."""
    x, z, yaw, length, width, height, bottom = parameters.T
    center = np.stack([x, bottom - height / 2, z], axis=1)
    return Boxes3D(center, length, width, height, yaw)


def to_box_frame(parameters: Floats, points_xz: Floats) -> tuple[Floats, Floats]:
    """(B, 7) and points (M, 2) or (B, M, 2) -> along, across (B, M), as each box sees them."""
    cos, sin = np.cos(parameters[:, YAW, None]), np.sin(parameters[:, YAW, None])
    x = points_xz[..., 0] - parameters[:, X, None]
    z = points_xz[..., 1] - parameters[:, Z, None]
    return cos * x - sin * z, sin * x + cos * z


def project_edges(parameters: Floats, image_P_cam: Floats) -> tuple[Floats, Floats]:
    """(B, 7) -> edges (B, 4) x1, y1, x2, y2 in pixels, uncut, and their derivatives (B, 4, 7).

    image_P_cam: (3, 4) from the frame of the boxes, which may be another than the camera's.
    """
    x, z, yaw, length, width, height, bottom = parameters.T[..., None]
    cos, sin = np.cos(yaw), np.sin(yaw)
    along, across = np.tile(_ALONG, 2), np.tile(_ACROSS, 2)
    is_top = np.repeat([0.0, 1.0], 4)
    from_x = cos * along * length + sin * across * width
    from_z = -sin * along * length + cos * across * width
    corners = np.stack([x + from_x, bottom - is_top * height + 0 * from_x, z + from_z], axis=-1)
    homogeneous = corners @ image_P_cam[:, :3].T + image_P_cam[:, 3]
    # What is nearer is moved along the optical axis.
    lacking = (_NEAREST_M - homogeneous[..., 2:]).clip(0)
    homogeneous += lacking * (image_P_cam[:, :3] @ image_P_cam[2, :3])
    depth = homogeneous[..., 2:]
    pixels = homogeneous[..., :2] / depth

    rows = np.arange(len(parameters))
    corner = np.stack(
        [
            pixels[..., 0].argmin(1),
            pixels[..., 1].argmin(1),
            pixels[..., 0].argmax(1),
            pixels[..., 1].argmax(1),
        ],
        axis=1,
    )
    axis = np.array([0, 1, 0, 1])
    picked = rows[:, None], corner
    edges = pixels[rows[:, None], corner, axis]
    # d(u/w)/d(x, y, z) = (P_u - u P_w) / w, row by row of the projection.
    by_corner = (image_P_cam[axis, :3] - edges[..., None] * image_P_cam[2, :3]) / depth[picked]
    by_x, by_y, by_z = by_corner[..., 0], by_corner[..., 1], by_corner[..., 2]
    top, a, b = is_top[corner], along[corner], across[corner]
    derivative = np.stack(
        [
            by_x,
            by_z,
            by_x * from_z[picked] - by_z * from_x[picked],
            (by_x * cos - by_z * sin) * a,
            (by_x * sin + by_z * cos) * b,
            -by_y * top,
            by_y,
        ],
        axis=-1,
    )
    return edges, derivative
