"""Any detector behind the interface: what becomes of its numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from boxlift import Frame, Prompt, Result
from boxlift.detector import Detector, find_prompts
from boxlift.errors import ImageError, ModelFileError
from boxlift.labeller import Labeller
from boxlift.settings import ACCURATE, DetectionSettings
from model.detector.detector_files import Box, brightness_detector, detector_file
from model.small_frame import CALIBRATION, IMAGE_SIZE_PX, car, frame_of

IMAGE = np.zeros((30, 40, 3), np.uint8)
BOX: Box = (10.0, 5.0, 20.0, 25.0)


def test_the_best_first_clipped_and_rounded(tmp_path: Path) -> None:
    path = detector_file(
        tmp_path / "own.onnx",
        [(1, 2, 3.14159, 4), (-5, -5, 50, 50), (41, 3, 45, 9), (7, 7, 7, 9), (5, 5, 6, 6)],
        [0.4, 0.87654321, 0.9, 0.9, 0.2],
        [1, 0, 0, 0, 0],
    )
    detector = Detector.open(path)
    assert (detector.name, len(detector.digest), detector.class_names) == ("own", 64, ("Car", "Pedestrian"))
    found = detector.detect(IMAGE)
    # One lies beside the image, one has no area, one is below the least score.
    assert found.prompts == (
        Prompt("Car", (0.0, 0.0, 40.0, 30.0), 0.8765),
        Prompt("Pedestrian", (1.0, 2.0, 3.14, 4.0), 0.4),
    )
    assert found.instance_ids is None
    assert len(detector.detect(IMAGE, min_score=0.0).prompts) == 3
    assert detector.detect(IMAGE, min_score=0.9).prompts == ()
    assert all(type(edge) is float for prompt in found.prompts for edge in prompt.box_px)


def test_nothing_found(tmp_path: Path) -> None:
    nothing = Detector.open(detector_file(tmp_path / "a.onnx", [], [], []))
    assert nothing.detect(IMAGE).prompts == ()
    masks = np.zeros((0, 30, 40), bool)
    ids = (
        Detector.open(detector_file(tmp_path / "b.onnx", [], [], [], masks=masks)).detect(IMAGE).instance_ids
    )
    assert ids is not None
    assert ids.shape == (30, 40)
    assert not ids.any()


@pytest.mark.parametrize("kind", [bool, np.uint8, np.float32])
def test_masks_become_instance_ids(tmp_path: Path, kind: type[Any]) -> None:
    masks = np.zeros((3, 30, 40), kind)
    masks[0, 5:25, 10:20] = 1
    masks[1, 10:20, 15:30] = 1  # overlaps the first, with a higher score
    masks[2] = 1  # below the least score
    if kind is np.float32:
        masks[0, 0, 0] = 0.5
    path = detector_file(
        tmp_path / "m.onnx", [BOX, (15, 10, 30, 20), (0, 0, 40, 30)], [0.5, 0.8, 0.1], [0, 1, 0], masks=masks
    )
    found = Detector.open(path).detect(IMAGE)
    assert [prompt.category for prompt in found.prompts] == ["Pedestrian", "Car"]
    expected = np.zeros((30, 40), np.uint16)
    expected[5:25, 10:20] = 2
    expected[10:20, 15:30] = 1
    np.testing.assert_array_equal(found.instance_ids, expected)


@pytest.mark.parametrize(
    ("boxes", "scores", "categories", "problem"),
    [
        ([(20, 5, 10, 8)], [0.9], [0], "some of its boxes_px are no x1, y1, x2, y2 with x1 <= x2"),
        ([(float("nan"), 5, 10, 8)], [0.9], [0], "some of its boxes_px are no x1, y1, x2, y2"),
        ([(0.1, 0.2, 0.3, 0.9)], [0.9], [0], "its boxes_px lie between 0 and 1; pixels of the image"),
        ([BOX], [1.5], [0], "some of its scores lie outside 0 to 1; probabilities are needed."),
        ([BOX], [float("nan")], [0], "some of its scores lie outside 0 to 1"),
        ([BOX], [0.9], [2], "some of its categories are no index of the 2 names in its property 'classes'."),
        ([BOX], [0.9], [-1], "some of its categories are no index"),
        ([BOX] * 1001, [0.9] * 1001, [0] * 1001, "it gives 1001 detections with a score of at least 0.3"),
    ],
)
def test_numbers_that_are_no_detections(
    tmp_path: Path, boxes: list[Box], scores: list[float], categories: list[int], problem: str
) -> None:
    path = detector_file(tmp_path / "own.onnx", boxes, scores, categories)
    with pytest.raises(ModelFileError) as caught:
        Detector.open(path).detect(IMAGE)
    assert str(caught.value).startswith(f"{path}: {problem}")
    assert "docs/detectors.md" in caught.value.remedy


def test_outputs_that_do_not_belong_together(tmp_path: Path) -> None:
    path = detector_file(tmp_path / "own.onnx", [BOX], [0.9, 0.8], [0])
    with pytest.raises(
        ModelFileError, match=r"its output 'scores' is float32 \(2\), .* with N = 1 is needed"
    ):
        Detector.open(path).detect(IMAGE)
    masks = np.zeros((1, 29, 40), bool)
    path = detector_file(tmp_path / "own.onnx", [BOX], [0.9], [0], masks=masks)
    with pytest.raises(ModelFileError, match=r"its output 'masks' .* with N = 1, H = 30, W = 40 is needed"):
        Detector.open(path).detect(IMAGE)


def test_files_that_are_no_detector(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "nothing.onnx", Path(__file__)):
        with pytest.raises(ModelFileError):
            Detector.open(path)
    path = detector_file(tmp_path / "a.onnx", [BOX], [0.9], [0], classes=[])
    with pytest.raises(ModelFileError, match="its property 'classes' is no JSON list of class names"):
        Detector.open(path)


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((30, 40), np.uint8),
        np.zeros((30, 40, 4), np.uint8),
        np.zeros((30, 40, 3), np.float32),
        np.zeros((0, 40, 3), np.uint8),
    ],
)
def test_arrays_that_are_no_image(tmp_path: Path, image: NDArray[Any]) -> None:
    detector = Detector.open(detector_file(tmp_path / "own.onnx", [BOX], [0.9], [0]))
    with pytest.raises(ImageError, match=r"Give uint8 \(H, W, 3\), RGB"):
        detector.detect(image)


def test_views_of_arrays_are_images(tmp_path: Path) -> None:
    detector = Detector.open(brightness_detector(tmp_path / "own.onnx"))
    image = np.zeros((30, 40, 3), np.uint8)
    image[4:9, 6:16, 2] = 200
    (prompt,) = detector.detect(image[:, :, ::-1]).prompts
    assert prompt == Prompt("Car", (6.0, 4.0, 16.0, 9.0), 0.9)


def test_a_frame_gets_prompts_and_masks_and_unknown_classes_stay(tmp_path: Path) -> None:
    cars = [car(0.0, 15.0, -1.5)]
    given = frame_of(cars)
    x1, y1, x2, y2 = given.prompts[0].box_px
    image = np.zeros((IMAGE_SIZE_PX[1], IMAGE_SIZE_PX[0], 3), np.uint8)
    image[int(y1) : int(y2) + 1, int(x1) : int(x2) + 1, 0] = 255
    frame = Frame("a", given.points_velo, CALIBRATION, IMAGE_SIZE_PX, image=image)

    found = find_prompts(frame, Detector.open(brightness_detector(tmp_path / "a.onnx")), DetectionSettings())
    np.testing.assert_array_equal(found.instance_ids, image[..., 0] // 255)
    (label,) = Labeller().label(found).objects
    assert label.result is Result.FITTED
    assert label.box is not None
    assert np.linalg.norm(label.box.center_cam[0] - cars[0].center_cam[0]) < 0.5

    box: Box = (x1, y1, x2, y2)
    unknown = detector_file(tmp_path / "b.onnx", [box, box], [0.9, 0.8], [1, 0], classes=("Car", "Tram"))
    frame = find_prompts(frame, Detector.open(unknown), ACCURATE.detection)
    assert [item.result.name for item in Labeller().label(frame).objects] == ["UNKNOWN_CLASS", "FITTED"]

    with pytest.raises(ImageError, match="frame 'by_hand' has no image to find objects in"):
        find_prompts(given, Detector.open(unknown), ACCURATE.detection)


def test_large_images_are_scaled_down_where_the_file_asks_for_it(tmp_path: Path) -> None:
    detector = Detector.open(brightness_detector(tmp_path / "own.onnx", longest_side_px="40"))
    small = np.zeros((30, 40, 3), np.uint8)
    small[4:9, 6:16, 0] = 200
    expected = detector.detect(small)
    assert expected.prompts == (Prompt("Car", (6.0, 4.0, 16.0, 9.0), 0.9),)
    large = small.repeat(5, axis=0).repeat(5, axis=1)
    found = detector.detect(large)
    assert found.prompts == (Prompt("Car", (30.0, 20.0, 80.0, 45.0), 0.9),)
    np.testing.assert_array_equal(found.instance_ids, large[..., 0] // 200)
    # What is averaged: stripes of one pixel are grey, and grey is not bright.
    striped = large.copy()
    striped[:, ::2] = 0
    striped[:10, :10] = 255
    assert detector.detect(striped).prompts[0].box_px == (0.0, 0.0, 10.0, 10.0)
    # An image of one row has one row still.
    found = detector.detect(np.full((1, 1000, 3), 255, np.uint8))
    assert found.prompts[0].box_px == (0.0, 0.0, 1000.0, 1.0)


@pytest.mark.parametrize("side", ["", "1280.0", "31", "-64", "wide", "9" * 20])
def test_a_longest_side_that_is_none(tmp_path: Path, side: str) -> None:
    path = brightness_detector(tmp_path / "own.onnx", longest_side_px=side)
    with pytest.raises(ModelFileError, match=r"'longest_side_px' is .*, no number of at least 32"):
        Detector.open(path)
