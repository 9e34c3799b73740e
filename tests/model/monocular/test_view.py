from __future__ import annotations

import numpy as np
import pytest

from boxlift import Calibration
from boxlift.monocular.view import MOST_PIXELS, view_of

CAM_SE3_VELO = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])


def camera(focal_x: float, focal_y: float | None = None) -> Calibration:
    focal_y = focal_y or focal_x
    return Calibration(
        np.array([[focal_x, 0, 300.0, 45], [0, focal_y, 90, 0.2], [0, 0, 1, 0.003]]), CAM_SE3_VELO
    )


@pytest.mark.parametrize("focal", [700.0, 735.0, 668.0])
def test_near_the_models_focal_length_nothing_is_touched(focal: float) -> None:
    image = np.zeros((180, 600, 3), np.uint8)
    view = view_of(image, camera(focal), 700)
    assert view.image is image
    assert view.scale == (1, 1)


@pytest.mark.parametrize(("focal_x", "focal_y"), [(350, 350), (1400, 1400), (350, 700), (911, 1003)])
def test_projection_boxes_and_pixels_are_scaled_alike(focal_x: float, focal_y: float) -> None:
    calibration = camera(focal_x, focal_y)
    image = np.zeros((180, 600, 3), np.uint8)
    image[60:120, 200:400] = 255
    view = view_of(image, calibration, 700)
    height, width = view.image.shape[:2]
    assert (width, height) == (round(600 * 700 / focal_x), round(180 * 700 / focal_y))

    points_cam = np.array([[1.0, 0.5, 20], [-3, 1, 9]])
    pixels, _ = calibration.project(points_cam)
    in_view, _ = Calibration(view.image_P_cam, CAM_SE3_VELO).project(points_cam)
    boxes_px = np.concatenate([pixels, pixels + 5], axis=1)
    np.testing.assert_allclose(view.boxes_in_view(boxes_px)[:, :2], in_view, atol=1e-9)
    np.testing.assert_allclose(view.boxes_in_original(view.boxes_in_view(boxes_px)), boxes_px)

    # The white rectangle lies where its edges (half a pixel outside its pixel centres) are mapped to.
    x1, y1, x2, y2 = view.boxes_in_view(np.array([[199.5, 59.5, 399.5, 119.5]]))[0]
    rows, columns = np.nonzero(view.image[..., 0] > 127)
    np.testing.assert_allclose((columns.min(), columns.max()), (x1 + 0.5, x2 - 0.5), atol=0.5)
    np.testing.assert_allclose((rows.min(), rows.max()), (y1 + 0.5, y2 - 0.5), atol=0.5)


@pytest.mark.parametrize(
    ("width", "height", "focal"),
    [
        (8000, 6000, 4000),
        (3000, 3000, 405),
        (20_000, 30, 2700),
        (30, 20_000, 40),
        (1, 1, 1),
        (3840, 2160, 700),
    ],
)
def test_whatever_the_image_the_model_sees_a_bounded_number_of_pixels(
    width: int, height: int, focal: float
) -> None:
    view = view_of(np.zeros((height, width, 3), np.uint8), camera(focal), 700)
    rows, columns, _ = view.image.shape
    assert rows * columns <= 1.01 * MOST_PIXELS
    assert min(rows, columns) >= 30
    assert view.scale == (columns / width, rows / height)
