"""Pictures: the right size, in the right places, and never a crash for odd boxes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from boxlift import Boxes3D, Calibration, Frame, FrameLabels, ObjectLabel, Prompt, Result
from boxlift.drawing import draw_frame, draw_objects
from boxlift.formats.kitti_label import KittiObject, from_box3d

WIDTH, HEIGHT = 1000, 300
CALIBRATION = Calibration(
    np.array([[700.0, 0, 500, 0], [0, 700, 150, 0], [0, 0, 1, 0]]),
    np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]),
)
ORANGE, BLUE, WHITE = (255, 140, 40), (70, 200, 255), (255, 255, 255)
PROMPT = Prompt("Car", (430, 130, 570, 220))


def frame(image: NDArray[np.uint8] | None = None, prompts: tuple[Prompt, ...] = (PROMPT,)) -> Frame:
    random = np.random.default_rng(0)
    points_velo = random.uniform([-10, -30, -2], [60, 30, 2], (4000, 3)).astype(np.float32)
    return Frame("f", points_velo, CALIBRATION, (WIDTH, HEIGHT), prompts, image)


def box(x: float, z: float, rotation_y: float = 0.3) -> Boxes3D:
    size = (np.array([side]) for side in (4.0, 1.8, 1.6))
    length, width, height = size
    return Boxes3D(np.array([[x, 1.0, z]]), length, width, height, np.array([rotation_y]))


def labelled(*boxes: Boxes3D | None) -> FrameLabels:
    return FrameLabels(
        "f",
        tuple(
            ObjectLabel(i, PROMPT, Result.FITTED if item else Result.TOO_FEW_POINTS, "", item, 0.5)
            for i, item in enumerate(boxes)
        ),
    )


def truth(x: float, z: float) -> KittiObject:
    return from_box3d("Car", PROMPT.box_px, box(x, z))


def has(picture: NDArray[np.uint8], color: tuple[int, int, int]) -> bool:
    return bool((np.abs(picture.astype(int) - color).max(axis=-1) < 12).any())


def test_image_above_and_view_from_above_below() -> None:
    image = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    picture = draw_frame(frame(image, prompts=()))
    assert picture.dtype == np.uint8
    assert picture.shape[1:] == (WIDTH, 3)
    assert picture.shape[0] > HEIGHT + 300
    drawn = (picture[:HEIGHT] != image).any(axis=-1)
    assert 0.001 < drawn.mean() < 0.1  # no prompt: the points are drawn on it, to see whether they fit
    assert has(picture[HEIGHT:], (58, 62, 70))  # rings


def test_a_prompt_without_labels_is_drawn_with_its_points() -> None:
    picture = draw_frame(frame(np.zeros((HEIGHT, WIDTH, 3), np.uint8)))
    assert has(picture[130:220, 430:570], ORANGE)
    assert has(picture[HEIGHT:], ORANGE)


def test_box_is_drawn_where_it_is() -> None:
    picture = draw_frame(frame(np.zeros((HEIGHT, WIDTH, 3), np.uint8)), labelled(None, box(-8, 20)))
    x1, y1, x2, y2 = box(-8, 20).project(CALIBRATION)[0].round().astype(int)
    assert has(picture[y1 - 2 : y2 + 3, x1 - 2 : x2 + 3], BLUE)
    below = picture[HEIGHT : HEIGHT + 550]  # without the list of prompts
    assert has(below[:, : WIDTH // 2], BLUE)
    assert not has(below[:, WIDTH // 2 :], BLUE)


def test_truth_is_white_and_only_there_where_it_is_given() -> None:
    empty = frame(np.zeros((HEIGHT, WIDTH, 3), np.uint8), ())
    assert not has(draw_frame(empty), WHITE)
    assert has(draw_frame(empty, truth=[truth(3, 15)])[HEIGHT:, WIDTH // 2 :], WHITE)


def test_without_an_image_the_points_take_its_place() -> None:
    picture = draw_frame(frame(), labelled(box(0, 15)))
    assert picture.shape[1] == WIDTH
    lit = (picture[:HEIGHT] > 60).any(axis=-1).mean()
    assert 0.001 < lit < 0.5


def test_objects_of_files() -> None:
    found = [from_box3d("Car", PROMPT.box_px, box(2, 12), score=0.5), truth(1, 30)]
    no_box = KittiObject("Car", -1, -1, -10, PROMPT.box_px, (-1, -1, -1), (-1000, -1000, -1000), -10, 0.2)
    dont_care = KittiObject("DontCare", -1, -1, -10, PROMPT.box_px, (-1, -1, -1), (-1000, -1000, -1000), -10)
    picture = draw_objects(frame(), [dont_care, *found, no_box], [truth(2, 12), dont_care])
    assert has(picture[HEIGHT:], ORANGE)
    assert has(picture[HEIGHT:], BLUE)
    assert has(picture[HEIGHT:], WHITE)


@pytest.mark.parametrize("size", [(320, 200), (4000, 1000), (5, 5)])
def test_any_image_size(size: tuple[int, int]) -> None:
    odd = Frame("f", np.ones((4, 3)), CALIBRATION, size, (PROMPT,))
    assert 960 <= draw_frame(odd, labelled(box(0, 10))).shape[1] <= 1920


@pytest.mark.parametrize(
    "odd",
    [box(0, 0), box(0, -20), box(0, 1.5), box(500, 3), box(0, 1e6), box(1e12, 1e12)],
    ids=["around", "behind", "partly behind", "beside", "far", "absurd"],
)
def test_odd_boxes(odd: Boxes3D) -> None:
    assert draw_frame(frame(), labelled(odd), [from_box3d("Car", PROMPT.box_px, odd)]).ndim == 3


@pytest.mark.parametrize(
    "box_px",
    [(9, 9, 9, 9), (60, 60, 10, 10), (-1e9, -1e9, 1e9, 1e9), (float("nan"),) * 4, (5000, 0, 6000, 9)],
)
def test_odd_prompts(box_px: tuple[float, float, float, float]) -> None:
    assert draw_frame(frame(prompts=(Prompt("Car", box_px),))).ndim == 3


def test_points_follow_the_masks() -> None:
    nowhere = np.zeros((HEIGHT, WIDTH), np.uint16)
    masked = Frame("f", frame().points_velo, CALIBRATION, (WIDTH, HEIGHT), (PROMPT,), None, nowhere)
    picture = draw_frame(masked)[HEIGHT : HEIGHT + 550]
    assert not has(picture, ORANGE)
