from __future__ import annotations

import numpy as np
import pytest

from boxlift.accurate.parameters import project_edges, to_box_frame, to_boxes
from boxlift.camera import Calibration, Floats
from model.accurate.by_hand import a_box
from model.small_frame import CALIBRATION

# A camera off the origin of the rectified frame, as KITTI's is: the fourth column matters.
OFFSET_CAMERA = Calibration(
    np.array([[721.5, 0, 609.6, 44.86], [0, 721.5, 172.9, 0.22], [0, 0, 1, 0.0027]]),
    CALIBRATION.cam_SE3_velo,
)


def some_boxes(count: int) -> Floats:
    rng = np.random.default_rng(0)
    low = np.array([-8.0, 8.0, -np.pi, 1.0, 0.6, 1.2, 1.2])
    high = np.array([8.0, 40.0, np.pi, 6.0, 2.4, 2.5, 2.2])
    return rng.uniform(low, high, (count, 7))


def test_the_seventh_number_is_the_bottom() -> None:
    boxes = to_boxes(a_box())
    assert boxes.bottom_y.tolist() == pytest.approx([1.65])
    assert boxes.center_cam[0].tolist() == pytest.approx([2.0, 1.65 - 0.75, 15.0])
    assert boxes.rotation_y.tolist() == pytest.approx([-1.2])


def test_the_corners_of_a_box_lie_half_its_sides_away_in_its_own_frame() -> None:
    boxes = some_boxes(5)
    along, across = to_box_frame(boxes, to_boxes(boxes).bev_corners())
    assert along == pytest.approx(boxes[:, 3, None] / 2 * np.array([1, -1, -1, 1]))
    assert across == pytest.approx(boxes[:, 4, None] / 2 * np.array([1, 1, -1, -1]))


def test_points_for_all_boxes_or_for_each_its_own() -> None:
    boxes, points_xz = some_boxes(3), np.array([[1.0, 10.0], [-2.0, 20.0]])
    shared = to_box_frame(boxes, points_xz)
    own = to_box_frame(boxes, np.broadcast_to(points_xz, (3, 2, 2)))
    assert np.array(shared).tolist() == np.array(own).tolist()


@pytest.mark.parametrize("calibration", [CALIBRATION, OFFSET_CAMERA])
def test_edges_are_those_of_the_projected_box(calibration: Calibration) -> None:
    boxes = some_boxes(50)
    edges, _ = project_edges(boxes, calibration.image_P_cam)
    assert edges == pytest.approx(to_boxes(boxes).project(calibration))


@pytest.mark.parametrize("calibration", [CALIBRATION, OFFSET_CAMERA])
def test_the_derivatives_of_the_edges_are_those_of_finite_differences(calibration: Calibration) -> None:
    boxes = some_boxes(50)
    _, derivative = project_edges(boxes, calibration.image_P_cam)
    step = 1e-6
    for column in range(7):
        aside = step * np.eye(7)[column]
        later, earlier = (project_edges(boxes + sign * aside, calibration.image_P_cam)[0] for sign in (1, -1))
        assert derivative[..., column] == pytest.approx((later - earlier) / (2 * step), rel=1e-4, abs=1e-3)


@pytest.mark.parametrize("offset", [-2.0, -0.3, 0.0, 0.3])
def test_a_box_around_the_camera_has_finite_edges(offset: float) -> None:
    """Also where the camera stands before or behind the origin of the rectified frame."""
    image_P_cam = CALIBRATION.image_P_cam.copy()
    image_P_cam[2, 3] = offset
    calibration = Calibration(image_P_cam, CALIBRATION.cam_SE3_velo)
    edges, derivative = project_edges(a_box(0.0, 0.0), calibration.image_P_cam)
    assert np.isfinite(edges).all()
    assert np.isfinite(derivative).all()
