"""Boxes3D: corners as its drawing says, projection, angles."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boxlift import Boxes3D, Calibration
from boxlift.boxes import alpha_from_rotation_y, rotation_y_from_alpha, wrap_angle

# 100 px focal length, principal point (50, 40), no rotation between LiDAR and camera.
PINHOLE = Calibration(np.array([[100.0, 0, 50, 0], [0, 100, 40, 0], [0, 0, 1, 0]]), np.eye(4))


def one_box(
    center: tuple[float, float, float],
    size_lwh: tuple[float, float, float] = (4, 2, 1),
    rotation_y: float = 0,
) -> Boxes3D:
    length, width, height = (np.array([side]) for side in size_lwh)
    return Boxes3D(np.array([center]), length, width, height, np.array([rotation_y]))


def test_corners_follow_the_drawing() -> None:
    corners = one_box((10, 1, 20)).corners()[0]
    assert corners.shape == (8, 3)
    np.testing.assert_allclose(
        corners[:4], [[12, 1.5, 21], [8, 1.5, 21], [8, 1.5, 19], [12, 1.5, 19]]
    )  # bottom face: y points down
    np.testing.assert_allclose(corners[4:], corners[:4] - [0, 1, 0])


def test_heading_is_cos_and_minus_sin() -> None:
    quarter = one_box((0, 0, 0), rotation_y=np.pi / 2)
    front = quarter.corners()[0][[0, 3, 4, 7]].mean(axis=0)
    np.testing.assert_allclose(front, [0, 0, -2], atol=1e-12)


def test_bev_corners_are_x_and_z_of_the_bottom_face_in_order_around() -> None:
    corners = one_box((10, 1, 20), rotation_y=0.3).bev_corners()[0]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
    np.testing.assert_allclose(sides, [2, 4, 2, 4])
    np.testing.assert_allclose(corners.mean(axis=0), [10, 20])


def test_bottom_is_below_the_centre() -> None:
    np.testing.assert_allclose(one_box((0, 1.2, 9), (4, 2, 1.6)).bottom_y, [2.0])


def test_projected_box_by_hand() -> None:
    # The near face z = 9 is the largest: x in [-2, 2], y in [-0.5, 0.5].
    box_px = one_box((0, 0, 10)).project(PINHOLE)
    np.testing.assert_allclose(box_px, [[50 - 200 / 9, 40 - 50 / 9, 50 + 200 / 9, 40 + 50 / 9]])


def test_box_partly_behind_the_camera_is_cut_at_the_near_plane() -> None:
    # x in [1, 3], z in [-4, 6]: rays through x = 3 at the near plane go far right, x = 1 at z = 6 stays.
    left, top, right, bottom = one_box((2, 0, 1), (2, 10, 1)).project(PINHOLE)[0]
    assert left == pytest.approx(50 + 100 / 6)
    assert right == pytest.approx(50 + 100 * 3 / 0.1)
    assert (top, bottom) == (pytest.approx(40 - 50 / 0.1), pytest.approx(40 + 50 / 0.1))


def test_box_behind_the_camera_has_no_projection() -> None:
    boxes = Boxes3D(np.array([[0, 0, -10], [0, 0, 10]]), np.ones(2), np.ones(2), np.ones(2), np.zeros(2))
    projected = boxes.project(PINHOLE)
    assert np.isnan(projected[0]).all()
    assert np.isfinite(projected[1]).all()


def test_box_around_the_camera_projects_to_finite_pixels() -> None:
    assert np.isfinite(one_box((0, 0, 0), (4, 4, 4)).project(PINHOLE)).all()


def test_empty_boxes() -> None:
    nothing = Boxes3D.empty()
    assert len(nothing) == 0
    assert nothing.corners().shape == (0, 8, 3)
    assert nothing.project(PINHOLE).shape == (0, 4)


def test_columns_of_another_length_are_refused() -> None:
    with pytest.raises(ValueError, match="width_m"):
        Boxes3D(np.zeros((2, 3)), np.ones(2), np.ones(3), np.ones(2), np.ones(2))


def test_selection_keeps_columns_together() -> None:
    boxes = Boxes3D(np.arange(9.0).reshape(3, 3), np.array([1.0, 2, 3]), np.ones(3), np.ones(3), np.zeros(3))
    chosen = boxes[np.array([False, False, True])]
    np.testing.assert_allclose(chosen.center_cam, [[6, 7, 8]])
    np.testing.assert_allclose(chosen.length_m, [3])


@pytest.mark.parametrize(
    ("center", "rotation_y", "alpha"),
    [
        ((0, 1, 10), 0.5, 0.5),  # straight ahead: the same
        ((10, 1, 10), 0.5, 0.5 - np.pi / 4),  # 45 degrees to the right
        ((-10, 1, 10), 0.5, 0.5 + np.pi / 4),
        ((-10, 1, 0), 3.0, 3.0 + np.pi / 2 - 2 * np.pi),  # wraps
    ],
)
def test_alpha_by_hand(center: tuple[float, float, float], rotation_y: float, alpha: float) -> None:
    found = alpha_from_rotation_y(np.array(rotation_y), np.array(center, dtype=float))
    assert float(found) == pytest.approx(alpha)
    back = rotation_y_from_alpha(found, np.array(center, dtype=float))
    assert float(back) == pytest.approx(rotation_y)


@given(st.floats(-1e6, 1e6))
def test_wrapped_angles_are_in_range_and_the_same_direction(angle: float) -> None:
    wrapped = float(wrap_angle(np.array(angle)))
    assert -np.pi <= wrapped < np.pi
    assert np.cos(wrapped - angle) == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("angle", [np.pi, -np.pi, np.nextafter(-np.pi, -4), 3 * np.pi, -1e-17])
def test_wrapping_at_the_seam(angle: float) -> None:
    assert -np.pi <= float(wrap_angle(np.array(angle))) < np.pi
