"""Quaternions and transforms, back and forth."""

from __future__ import annotations

import numpy as np
import pytest

from boxlift.poses import about_z, inverse, pose, quaternion_of, rotation_of

_HALF_TURNS = [np.diag(signs).astype(float) for signs in ((1, -1, -1), (-1, 1, -1), (-1, -1, 1))]


def random_rotations(count: int) -> list[np.ndarray]:
    quaternions = np.random.default_rng(4).normal(size=(count, 4))
    return list(rotation_of(quaternions))


@pytest.mark.parametrize("rotation", [np.eye(3), *_HALF_TURNS, *random_rotations(20)])
def test_a_rotation_is_its_quaternion_s(rotation: np.ndarray) -> None:
    """Half turns have w = 0, where the common formula divides by nothing."""
    quaternion = quaternion_of(rotation)
    assert quaternion[0] >= 0
    assert np.linalg.norm(quaternion) == pytest.approx(1)
    assert np.allclose(rotation_of(np.array([quaternion]))[0], rotation, atol=1e-12)


def test_quaternions_by_hand() -> None:
    half = np.sqrt(0.5)
    assert quaternion_of(about_z(np.pi / 2)) == pytest.approx((half, 0, 0, half))
    assert np.allclose(rotation_of(np.array([[3.0, 3, 0, 0]]))[0] @ (0, 1, 0), (0, 0, 1))


def test_an_inverse_leads_back() -> None:
    there = pose(random_rotations(1)[0], np.array([3.0, -4, 5]))
    assert np.allclose(inverse(there) @ there, np.eye(4))
    assert np.allclose(pose(np.eye(3), np.array([1.0, 2, 3])) @ (0, 0, 0, 1), (1, 2, 3, 1))
