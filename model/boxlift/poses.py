"""Rigid transforms, a_SE3_b: (4, 4) from frame b to frame a, and the quaternions that files hold them as."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def pose(rotation: Floats, translation_m: Floats) -> Floats:
    """(3, 3) rotation and (3,) translation -> (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = translation_m
    return matrix


def inverse(a_SE3_b: Floats) -> Floats:
    """b_SE3_a; the rotation is taken for orthonormal."""
    rotation = a_SE3_b[:3, :3].T
    return pose(rotation, -rotation @ a_SE3_b[:3, 3])


def rotation_of(quaternions_wxyz: Floats) -> Floats:
    """(N, 4) quaternions w, x, y, z of any length but 0 -> (N, 3, 3) rotations."""
    w, x, y, z = (quaternions_wxyz / np.linalg.norm(quaternions_wxyz, axis=1, keepdims=True)).T
    rows: Floats = np.stack(
        [
            *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        ],
        axis=1,
    ).reshape(-1, 3, 3)
    return rows


def quaternion_of(rotation: Floats) -> tuple[float, float, float, float]:
    """(3, 3) rotation -> unit quaternion w, x, y, z with w >= 0.

    By the largest of the four components, which loses no digits (Shepperd, 1978).
    """
    r = rotation
    squares = np.array(
        [
            1 + r[0, 0] + r[1, 1] + r[2, 2],
            1 + r[0, 0] - r[1, 1] - r[2, 2],
            1 - r[0, 0] + r[1, 1] - r[2, 2],
            1 - r[0, 0] - r[1, 1] + r[2, 2],
        ]
    )
    products = np.array(
        [
            [squares[0], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], squares[1], r[1, 0] + r[0, 1], r[0, 2] + r[2, 0]],
            [r[0, 2] - r[2, 0], r[1, 0] + r[0, 1], squares[2], r[2, 1] + r[1, 2]],
            [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[2, 1] + r[1, 2], squares[3]],
        ]
    )
    row = products[int(squares.argmax())]
    w, x, y, z = (float(value) for value in row / np.linalg.norm(row) * (1 if row[0] >= 0 else -1))
    return w, x, y, z


def about_z(yaw_rad: float) -> Floats:
    """(3, 3) rotation about z, counter-clockwise seen from above."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
