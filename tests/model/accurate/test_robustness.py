"""Whatever comes in: every prompt is told of, and every box is made of finite numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from boxlift import Boxes3D, Frame, Prompt
from boxlift.camera import Calibration, Floats
from boxlift.labeller import Labeller
from model.small_frame import CALIBRATION, car, frame_of

FRAME = frame_of([car(3.0, 14.0, -1.4), car(-5.0, 22.0, -1.7), car(6.0, 30.0, 0.0)])
# A metre about the origin.
CROWD = np.random.default_rng(0).normal(0, 1, (3000, 3))
ANYWHERE = np.random.default_rng(1).uniform(0, 1, (5000, 3))
# In the prompt of the first car.
ON_THE_CAR = np.array([13.0, -2.9, -0.9])
CLASSES = ("Car", "Pedestrian", "Cyclist", "Truck")


def boxes_of(frame: Frame) -> list[Boxes3D]:
    """All boxes of a frame's labels, chosen and rejected, once they are found to be finite."""
    labels = Labeller().label(frame)
    assert [label.index for label in labels.objects] == list(range(len(frame.prompts)))
    boxes = []
    for label in labels.objects:
        assert label.sentence
        assert 0 <= label.score <= 1
        assert (label.box is None) == (label.iou_probability is None)
        boxes += [hypothesis.box for hypothesis in label.rejected]
        boxes += [] if label.box is None else [label.box]
    for box in boxes:
        numbers = np.array([*box.center_cam[0], box.length_m[0], box.width_m[0], box.height_m[0]])
        assert np.isfinite([*numbers, *box.rotation_y]).all()
        assert (numbers[3:] > 0).all()
        assert np.abs(numbers).max() < 1000
    return boxes


@pytest.mark.parametrize(
    "points_velo",
    [
        np.empty((0, 3)),
        ON_THE_CAR[None],
        np.tile(ON_THE_CAR, (3, 1)),
        np.tile(ON_THE_CAR, (500, 1)),
        np.concatenate([FRAME.points_velo[:6000], np.tile(ON_THE_CAR, (500, 1))]),
        ON_THE_CAR + np.linspace(0, 1, 300)[:, None] * [0.0, 0, 1],
        ON_THE_CAR + np.linspace(0, 9, 300)[:, None] * [1.0, 0, 0],
        ON_THE_CAR * np.linspace(0.2, 3, 300)[:, None],
        np.concatenate([FRAME.points_velo, 2e6 * (ANYWHERE - 0.5), np.full((9, 3), 1e6)]),
        1e6 * ANYWHERE * [1.0, 0.3, 0.05],
        CROWD,
        CROWD + np.array([1.5, 0, 0]),
        1e-3 * ANYWHERE + ON_THE_CAR,
    ],
    ids=[
        "none",
        "one",
        "three in one place",
        "all in one place",
        "all in one place over ground",
        "a post",
        "a line away",
        "one ray",
        "a few a thousand kilometres away",
        "all a thousand kilometres away",
        "around the sensor",
        "before the camera",
        "in a millimetre",
    ],
)
def test_points(points_velo: Floats) -> None:
    prompts = [replace(prompt, category=name) for prompt in FRAME.prompts for name in CLASSES]
    boxes_of(replace(FRAME, points_velo=points_velo, prompts=(*FRAME.prompts, *prompts)))


def test_single_precision_gives_the_same_boxes() -> None:
    single = boxes_of(replace(FRAME, points_velo=FRAME.points_velo.astype(np.float32)))
    for box, other in zip(boxes_of(FRAME), single, strict=True):
        assert box.center_cam == pytest.approx(other.center_cam, abs=0.05)


@pytest.mark.parametrize(
    "box_px",
    [
        (-5000.0, -5000.0, 9000.0, 9000.0),
        (-9e5, -9e5, 9e5, 9e5),
        (0.0, 0.0, 1242.0, 375.0),
        (-1e5, 10.0, 3.0, 300.0),
        (715.0, 200.0, 715.001, 260.0),
        (700.0, 215.0, 830.0, 215.001),
        (715.0, 0.0, 716.0, 374.0),
        (1241.5, 374.5, 1300.0, 400.0),
        (0.0, 0.0, 0.5, 0.5),
    ],
    ids=str,
)
def test_prompts(box_px: tuple[float, float, float, float]) -> None:
    boxes_of(replace(FRAME, prompts=tuple(Prompt(name, box_px) for name in CLASSES)))


@pytest.mark.parametrize("category", CLASSES)
def test_fifty_times_the_same_prompt(category: str) -> None:
    prompt = replace(FRAME.prompts[0], category=category)
    boxes = boxes_of(replace(FRAME, prompts=(prompt,) * 50))
    # A prompt of a car's shape may hold nothing that looks like a person.
    assert boxes or category != "Car"


@pytest.mark.parametrize("offset", [-2.0, -0.3, 0.3, 2.0])
def test_a_camera_before_or_behind_the_origin_of_the_frame(offset: float) -> None:
    """The fourth column's last number: where depth is zero is not where z is."""
    image_P_cam = CALIBRATION.image_P_cam.copy()
    image_P_cam[:, 3] = (40.0, 0.2, offset)
    calibration = Calibration(image_P_cam, CALIBRATION.cam_SE3_velo)
    close = 0.7 * CROWD + np.array([2.0, 0, 0])
    points_velo = np.concatenate([FRAME.points_velo, close])
    prompts = (*FRAME.prompts, Prompt("Car", (0.0, 0.0, 1242.0, 375.0)), Prompt("Car", (0, 100, 400, 375)))
    boxes_of(replace(FRAME, calibration=calibration, points_velo=points_velo, prompts=prompts))


def test_prompts_at_random() -> None:
    rng = np.random.default_rng(2)
    corners = rng.uniform(-200, 1400, (60, 2, 2)) * [1.0, 0.3]
    (low, high), names = (corners.min(1), corners.max(1)), rng.choice(CLASSES, 60)
    prompts = [
        Prompt(str(name), (float(a), float(b), float(c), float(d)))
        for name, (a, b), (c, d) in zip(names, low, high, strict=True)
    ]
    assert boxes_of(replace(FRAME, prompts=tuple(prompts)))
