"""Boxes are judged one by one: by what lies in them and beside them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from boxlift import Frame, Prompt
from boxlift.box_evidence import BoxEvidence, judge_boxes
from boxlift.camera import Floats
from boxlift.priors import SIZE_PRIORS
from model.small_frame import CALIBRATION, IMAGE_SIZE_PX

# 720 px of focal length and a Car of 1.6 m: 72 px tall is 16 m away.
BOX = (500.0, 150.0, 600.0, 222.0)
RAYS = np.stack(np.meshgrid(np.arange(300.0, 800.0, 5), np.arange(140.0, 240.0, 5)), axis=-1).reshape(-1, 2)


def seen(depth_m: Floats, *prompts: Prompt, rays: Floats = RAYS) -> Frame:
    """A frame with one point per ray, so far away."""
    points_velo = CALIBRATION.cam_to_velo(CALIBRATION.back_project(rays, depth_m))
    return Frame("rays", points_velo, CALIBRATION, IMAGE_SIZE_PX, prompts or (Prompt("Car", BOX),))


def inside() -> NDArray[np.bool_]:
    """Which of RAYS go through BOX."""
    (column, row), (x1, y1, x2, y2) = RAYS.T, BOX
    return (column > x1) & (column < x2) & (row > y1) & (row < y2)


def test_points_where_the_object_would_be_and_none_beside_it() -> None:
    evidence = judge_boxes(seen(np.where(inside(), 16.0, 40.0)), SIZE_PRIORS)
    assert evidence == BoxEvidence(judged=1, holding=1, points_in_image=len(RAYS))


@pytest.mark.parametrize("depth_m", [8.0, 16.0, 40.0])
def test_a_wall_is_no_object_at_any_distance(depth_m: float) -> None:
    assert judge_boxes(seen(np.full(len(RAYS), depth_m)), SIZE_PRIORS) == BoxEvidence(1, 0, len(RAYS))


def test_an_object_at_another_distance_is_not_the_boxes() -> None:
    assert judge_boxes(seen(np.where(inside(), 9.0, 40.0)), SIZE_PRIORS).holding == 0
    truck = Prompt("Truck", BOX)  # twice as tall, so twice as far away
    assert judge_boxes(seen(np.where(inside(), 34.0, 60.0), truck), SIZE_PRIORS).holding == 1


def test_no_points_among_many_speak_against_a_box_and_nothing_at_all_does_not() -> None:
    around = RAYS[~inside()]
    assert judge_boxes(seen(np.full(len(around), 40.0), rays=around), SIZE_PRIORS) == BoxEvidence(
        judged=1, holding=0, points_in_image=len(around)
    )
    elsewhere = RAYS[RAYS[:, 0] < 400]
    assert judge_boxes(seen(np.full(len(elsewhere), 40.0), rays=elsewhere), SIZE_PRIORS).judged == 0


def test_points_that_stand_out_by_number_only_leave_it_open() -> None:
    """One in five points is on the object: several sweeps in one cloud see the ground behind it too."""
    on_object = inside() & (np.arange(len(RAYS)) % 5 == 0)
    assert judge_boxes(seen(np.where(on_object, 16.0, 40.0)), SIZE_PRIORS).judged == 0


@pytest.mark.parametrize(
    "prompt",
    [
        Prompt("Unicorn", BOX),
        Prompt("Car", (0.0, 150.0, 100.0, 222.0)),  # cut by the image's border
        Prompt("Car", (500.0, 150.0, 520.0, 160.0)),  # too low
        Prompt("Car", (600.0, 150.0, 500.0, 222.0)),
        Prompt("Car", (float("nan"), 150.0, 600.0, 222.0)),
    ],
)
def test_boxes_that_cannot_tell(prompt: Prompt) -> None:
    assert judge_boxes(seen(np.full(len(RAYS), 16.0), prompt), SIZE_PRIORS).judged == 0


def test_who_is_hidden_behind_another_is_not_asked() -> None:
    hidden = Prompt("Car", (540.0, 150.0, 600.0, 190.0))
    evidence = judge_boxes(seen(np.where(inside(), 16.0, 40.0), hidden, Prompt("Car", BOX)), SIZE_PRIORS)
    assert (evidence.judged, evidence.holding) == (1, 1)


def test_a_class_of_ones_own_counts_with_its_size() -> None:
    frame = seen(np.where(inside(), 16.0, 40.0), Prompt("Taxi", BOX))
    assert judge_boxes(frame, {"Taxi": SIZE_PRIORS["Car"]}).holding == 1


@pytest.mark.parametrize(
    ("judged", "holding", "confirms", "contradicts"),
    [(2, 0, False, False), (2, 2, False, False), (3, 0, False, True), (3, 1, False, False),
     (3, 2, True, False), (10, 2, False, True), (10, 3, False, False), (10, 5, False, False)],
)  # fmt: skip
def test_few_boxes_decide_nothing(judged: int, holding: int, confirms: bool, contradicts: bool) -> None:
    evidence = BoxEvidence(judged, holding, points_in_image=0)
    assert (evidence.confirms, evidence.contradicts) == (confirms, contradicts)


def test_points_in_the_image_are_those_in_front() -> None:
    frame = seen(np.full(len(RAYS), 16.0))
    behind = CALIBRATION.cam_to_velo(CALIBRATION.velo_to_cam(frame.points_velo) * -1)
    both = replace(frame, points_velo=np.concatenate([frame.points_velo, behind]))
    assert judge_boxes(both, SIZE_PRIORS) == judge_boxes(frame, SIZE_PRIORS)


def test_what_its_detector_doubts_is_not_judged() -> None:
    wall = np.full(len(RAYS), 16.0)
    assert judge_boxes(seen(wall, Prompt("Car", BOX, 0.5)), SIZE_PRIORS).judged == 1
    assert judge_boxes(seen(wall, Prompt("Car", BOX, 0.49)), SIZE_PRIORS).judged == 0
