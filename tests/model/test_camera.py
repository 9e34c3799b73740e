"""Calibration: projection, centres, and refusals that name what is wrong."""

from __future__ import annotations

import re

import numpy as np
import pytest

from boxlift import Calibration
from boxlift.errors import CalibrationError

# Optical centre at (1, 0, 0): image_P_cam[:, 3] = -K @ centre.
P = np.array([[100.0, 0, 50, -100], [0, 120, 40, 0], [0, 0, 1, 0]])
# LiDAR x forward, y left, z up, 2 m above and 1 m behind the camera.
CAM_SE3_VELO = np.array([[0.0, -1, 0, 0], [0, 0, -1, -2], [1, 0, 0, -1], [0, 0, 0, 1]])


def test_a_point_by_hand() -> None:
    calibration = Calibration(P, CAM_SE3_VELO)
    point_cam = calibration.velo_to_cam(np.array([[11.0, -3, 2, 0.7]]))  # 11 ahead, 3 right, 2 up
    np.testing.assert_allclose(point_cam, [[3, -4, 10]])
    pixels, depth_m = calibration.project(point_cam)
    np.testing.assert_allclose(pixels, [[50 + 100 * 2 / 10, 40 - 120 * 4 / 10]])
    np.testing.assert_allclose(depth_m, [10])


def test_centres_and_focal_lengths() -> None:
    calibration = Calibration(P, CAM_SE3_VELO)
    np.testing.assert_allclose(calibration.camera_center_cam, [1, 0, 0])
    np.testing.assert_allclose(calibration.lidar_center_cam, [0, -2, -1])
    assert calibration.focal_px == (100, 120)


def test_camera_centre_projects_to_nothing() -> None:
    calibration = Calibration(P, CAM_SE3_VELO)
    pixels, depth_m = calibration.project(calibration.camera_center_cam[None])
    assert depth_m[0] == 0
    assert np.isnan(pixels).all()


def test_points_behind_have_depth_but_no_pixels() -> None:
    pixels, depth_m = Calibration(P, CAM_SE3_VELO).project(np.array([[0.0, 0, -5], [0, 0, 5]]))
    np.testing.assert_allclose(depth_m, [-5, 5])
    assert np.isnan(pixels[0]).all()
    assert np.isfinite(pixels[1]).all()


def test_round_trips() -> None:
    random = np.random.default_rng(0)
    projection = P + np.array([[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0.003]])  # KITTI's P2 has one
    calibration = Calibration(projection, CAM_SE3_VELO)
    points_cam = random.uniform([-20, -3, 1], [20, 3, 80], (50, 3))
    pixels, depth_m = calibration.project(points_cam)
    np.testing.assert_allclose(calibration.back_project(pixels, depth_m), points_cam, atol=1e-9)
    np.testing.assert_allclose(calibration.velo_to_cam(calibration.cam_to_velo(points_cam)), points_cam)


@pytest.mark.parametrize(
    ("image_P_cam", "cam_SE3_velo", "field", "says"),
    [
        (np.zeros((3, 4)), CAM_SE3_VELO, "image_P_cam", "singular"),
        (P, np.zeros((4, 4)), "cam_SE3_velo", "singular"),
        (P[:, :3], CAM_SE3_VELO, "image_P_cam", "(3, 3)"),
        (P, np.where(np.eye(4) == 1, np.nan, CAM_SE3_VELO), "cam_SE3_velo", "not finite"),
        ("nonsense", CAM_SE3_VELO, "image_P_cam", "nonsense"),
        ([[10**400] * 4] * 3, CAM_SE3_VELO, "image_P_cam", "not a matrix"),
    ],
)
def test_refusals(image_P_cam: np.ndarray, cam_SE3_velo: np.ndarray, field: str, says: str) -> None:
    with pytest.raises(CalibrationError) as caught:
        Calibration(image_P_cam, cam_SE3_velo)
    assert caught.value.field == field
    assert says in caught.value.problem
    assert caught.value.remedy


@pytest.mark.parametrize(
    ("row", "column", "value", "says"),
    [
        (0, 1, 1.0, "no rigid transform"),  # mirrored
        (2, 0, 1.1, "no rigid transform"),  # stretched
        (0, 0, 0.1, "no rigid transform"),  # sheared
        (3, 0, 0.1, "no rigid transform"),
        (0, 3, 1e100, "1e+100"),
    ],
)
def test_a_lidar_that_cannot_be_is_refused(row: int, column: int, value: float, says: str) -> None:
    matrix = CAM_SE3_VELO.copy()
    matrix[row, column] = value
    with pytest.raises(CalibrationError, match=re.escape(says)) as caught:
        Calibration(P, matrix)
    assert caught.value.field == "cam_SE3_velo"


@pytest.mark.parametrize(
    ("row", "column", "value", "says"),
    [(2, 0, 1e6, "third row"), (2, 2, -1.0, "third row"), (0, 3, 1e100, "no camera has")],
)
def test_a_camera_that_cannot_be_is_refused(row: int, column: int, value: float, says: str) -> None:
    matrix = P.copy()
    matrix[row, column] = value
    with pytest.raises(CalibrationError, match=says) as caught:
        Calibration(matrix, CAM_SE3_VELO)
    assert caught.value.field == "image_P_cam"


def test_rotations_rounded_to_two_decimals_pass() -> None:
    angle = np.deg2rad(33)
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    Calibration(P, np.round(CAM_SE3_VELO @ turn, 2))


def test_matrices_cannot_be_changed_from_outside() -> None:
    given = P.copy()
    calibration = Calibration(given, CAM_SE3_VELO)
    given[0, 0] = 7
    assert calibration.image_P_cam[0, 0] == 100
    with pytest.raises(ValueError, match="read-only"):
        calibration.image_P_cam[0, 0] = 7
