"""Images with distortion, made straight."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from boxlift.datasets import load_prompts, open_source
from boxlift.errors import CalibrationError
from boxlift.formats.calibration import parse_calibration
from boxlift.lens import Lens

_K = np.array([[300.0, 0, 320], [0, 310, 240], [0, 0, 1]])
_SIZE_PX = (640, 480)
_LENSES = {
    "plumb_bob": (-0.3, 0.1, 0.001, -0.002, 0.01),
    "rational_polynomial": (0.5, 0.02, 0.001, -0.001, 0.001, 0.8, 0.05, 0.002),
    "kannala_brandt": (-0.02, 0.005, -0.001, 0.0002),
}


def lens_of(model: str) -> Lens:
    lens = Lens.of(_K, model, _LENSES[model])
    assert lens is not None
    return lens


def through_lens(straight_px: NDArray[np.float64], model: str) -> NDArray[np.float64]:
    """Pixels of a pinhole -> where OpenCV says that the lens puts them."""
    rays = np.column_stack([(straight_px - _K[:2, 2]) / (_K[0, 0], _K[1, 1]), np.ones(len(straight_px))])
    rays, none, coefficients = rays.reshape(-1, 1, 3), np.zeros(3), np.array(_LENSES[model])
    project = cv2.fisheye.projectPoints if model == "kannala_brandt" else cv2.projectPoints
    pixels, _ = project(rays, none, none, _K, coefficients)
    return np.asarray(pixels, dtype=np.float64).reshape(-1, 2)


@pytest.mark.parametrize("model", sorted(_LENSES))
def test_pixels_go_where_a_pinhole_has_them(model: str) -> None:
    straight = np.array([[320.0, 240.0], [100, 80], [560, 400], [330, 20]])
    bent = through_lens(straight, model)
    assert np.abs(bent - straight).max() > 3
    assert np.allclose(lens_of(model).rectified_pixels(bent), straight, atol=0.1)


@pytest.mark.parametrize("model", sorted(_LENSES))
def test_an_image_and_its_masks_are_straight_afterwards(model: str) -> None:
    """A dot drawn where the lens puts a ray is found where a pinhole would put it."""
    straight = np.array([[150.0, 120.0], [450, 330]])
    image = np.zeros((480, 640, 3), np.uint8)
    ids = np.zeros((480, 640), np.uint16)
    for number, (x, y) in enumerate(through_lens(straight, model).round().astype(int), start=1):
        image[y - 1 : y + 2, x - 1 : x + 2] = 255
        ids[y - 2 : y + 3, x - 2 : x + 3] = 300 + number
    lens = lens_of(model)
    rectified, rectified_ids = lens.rectified_image(image), lens.rectified_ids(ids)
    assert rectified.shape == image.shape
    assert set(np.unique(rectified_ids)) == {0, 301, 302}
    for number, (x, y) in enumerate(straight.astype(int), start=1):
        assert rectified[y, x].min() > 128
        assert rectified_ids[y, x] == 300 + number


def test_a_box_grows_or_shrinks_with_its_outline() -> None:
    lens = lens_of("plumb_bob")
    box = (40.0, 100.0, 120.0, 200.0)
    x1, y1, x2, y2 = lens.rectified_box(box, _SIZE_PX)
    # A barrel pulls the border in: straightened, things there move out and get larger.
    assert x1 < box[0]
    assert x2 - x1 > box[2] - box[0]
    assert x1 >= 0
    assert 0 < y1 < y2 < 480
    nothing = (5.0, 5.0, 5.0, 9.0)
    assert lens.rectified_box(nothing, _SIZE_PX) == nothing


def test_a_straight_lens_is_none() -> None:
    assert Lens.of(_K, "plumb_bob", (0, 0, 0, 0, 0)) is None
    assert Lens.of(_K, "", ()) is None


@pytest.mark.parametrize(
    ("values", "where"),
    [
        ({"distortion": [0.1, 0.2], "distortion_model": "plumb_bob"}, "calib.distortion"),
        ({"distortion": [0.1] * 6, "distortion_model": "cylinder"}, "calib.distortion_model"),
        ({"distortion": "bent"}, "calib.distortion"),
        ({"distortion": [0.1, None, 0, 0]}, "calib.distortion"),
    ],
)
def test_lenses_that_cannot_be_rectified_are_refused(values: dict[str, object], where: str) -> None:
    text = json.dumps(calibration_json() | values)
    with pytest.raises(CalibrationError) as raised:
        parse_calibration(text, with_lens=True)
    assert raised.value.field == where


def test_who_cannot_rectify_refuses() -> None:
    text = json.dumps(calibration_json() | {"distortion": list(_LENSES["plumb_bob"])})
    with pytest.raises(CalibrationError, match="not rectified"):
        parse_calibration(text)


def calibration_json() -> dict[str, object]:
    axes = [[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]
    return {"P2": np.column_stack([_K, np.zeros(3)]).tolist(), "cam_T_velo": axes}


def test_a_plain_folder_with_a_distortion(tmp_path: Path) -> None:
    for part in ("velodyne", "calib", "image_2", "boxes", "masks"):
        (tmp_path / part).mkdir()
    (tmp_path / "velodyne" / "a.bin").write_bytes(np.ones((5, 4), np.float32).tobytes())
    values = calibration_json() | {"distortion": list(_LENSES["plumb_bob"])}
    (tmp_path / "calib" / "a.json").write_text(json.dumps(values))
    pixels = np.random.default_rng(1).integers(0, 255, (480, 640, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(tmp_path / "image_2" / "a.png")
    Image.fromarray(np.ones((480, 640), np.uint16)).save(tmp_path / "masks" / "a.png")
    (tmp_path / "boxes" / "a.txt").write_text("Car -1 -1 -10 40 100 120 200 -1 -1 -1 -1000 -1000 -1000 -10\n")
    source = open_source(tmp_path)
    frame = source.load("a", masks=tmp_path / "masks", with_image=True)
    lens = lens_of("plumb_bob")
    assert frame.lens == lens
    assert frame.image is not None
    assert np.array_equal(frame.image, lens.rectified_image(pixels))
    assert frame.instance_ids is not None
    assert frame.instance_ids[240, 320] == 1
    (prompt,) = load_prompts(str(tmp_path / "boxes"), source, "a")
    assert prompt.box_px == (40, 100, 120, 200)  # as it was drawn; a run rectifies it
