from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from boxlift import Frame, Prompt, Result
from boxlift.ground import find_ground
from boxlift.object_points import (
    ObjectPoints,
    UnusablePrompt,
    largest_cluster,
    lower_half,
    points_in_image,
    sample,
    select_object_points,
)
from boxlift.settings import PAPER, RELEASE
from model.small_frame import CALIBRATION, CAMERA_HEIGHT_M, IMAGE_SIZE_PX, car, face_points, frame_of


def select(frame: Frame) -> list[ObjectPoints | UnusablePrompt]:
    visible = points_in_image(frame)
    ground = find_ground(visible.cam, frame.name, PAPER.ground)
    return select_object_points(frame, visible, ground, PAPER.points, PAPER.sizes)


def test_points_of_a_car_are_on_the_car() -> None:
    box = car(3.0, 15.0, -1.4)
    (found,) = select(frame_of([box]))
    assert isinstance(found, ObjectPoints)
    assert found.counts.used == len(found.used) == 100
    assert found.counts.in_prompt > found.counts.above_ground >= found.counts.in_cluster > 200
    offset = found.used - box.center_cam[0]
    along = offset[:, 0] * np.cos(-1.4) - offset[:, 2] * np.sin(-1.4)
    across = offset[:, 0] * np.sin(-1.4) + offset[:, 2] * np.cos(-1.4)
    assert (np.abs(along) < 2.1).all()
    assert (np.abs(across) < 1.0).all()
    # The upper half is gone: y points down, the median height of the faces is y >= centre.
    assert (found.used[:, 1] >= np.median(found.cluster[:, 1])).all()
    assert (found.used[:, 1] < CAMERA_HEIGHT_M - 0.1).all()


def test_a_mask_leaves_the_neighbour_out() -> None:
    """Two cars overlap in the image; the mask of the far one holds only its own pixels."""
    near, far = car(0.0, 9.0, -1.5), car(1.6, 17.0, -1.5)
    frame = frame_of([near, far])
    ids = np.zeros(IMAGE_SIZE_PX[::-1], dtype=np.uint16)
    for index in (1, 0):  # the near car hides the far one
        x1, y1, x2, y2 = (int(edge) for edge in frame.prompts[index].box_px)
        ids[y1 : y2 + 1, x1 : x2 + 1] = index + 1
    by_box, by_mask = select(frame)[1], select(replace(frame, instance_ids=ids))[1]
    assert isinstance(by_box, ObjectPoints)
    assert isinstance(by_mask, ObjectPoints)
    # The box alone gives the occluder, which has as many points; the paper knows no better.
    assert by_mask.counts.in_prompt < by_box.counts.in_prompt
    assert abs(np.median(by_mask.used[:, 2]) - 16) < 1.5


PROMPT_ERRORS = [
    (Prompt("Spaceship", (10, 10, 50, 50)), Result.UNKNOWN_CLASS, "'Spaceship' has no size prior"),
    (Prompt("Car", (50, 50, 50, 90)), Result.BAD_BOX, "(50, 50, 50, 90) has no area"),
    (Prompt("Car", (90, 50, 50, 90)), Result.BAD_BOX, "x2 > x1"),
    (Prompt("Car", (float("nan"), 0, 50, 90)), Result.BAD_BOX, "nan"),
    (Prompt("Car", (0, 0, float("inf"), 90)), Result.BAD_BOX, "inf"),
    (Prompt("Car", (-1e300, -1e300, 1e300, 1e300)), Result.BAD_BOX, "absurd numbers"),
    (Prompt("Car", (-90, 10, -5, 50)), Result.BOX_OUTSIDE_IMAGE, "1242 x 375"),
    (Prompt("Car", (2000, 10, 2100, 50)), Result.BOX_OUTSIDE_IMAGE, "outside the image"),
    (Prompt("Car", (10, 1, 60, 20)), Result.TOO_FEW_POINTS, "(0, at least 5 are needed)"),
]


@pytest.mark.parametrize(("prompt", "result", "words"), PROMPT_ERRORS)
def test_a_prompt_that_cannot_be_used_says_why(prompt: Prompt, result: Result, words: str) -> None:
    (found,) = select(frame_of([car(3.0, 15.0, -1.4)], [prompt]))
    assert isinstance(found, UnusablePrompt)
    assert found.result is result
    assert words in found.sentence


def test_two_points_are_too_few() -> None:
    frame = frame_of([car(3.0, 15.0, -1.4)])
    two = np.array([[0.0, 1.0, 15.0], [0.1, 1.0, 15.0]])
    frame = replace(
        frame, points_velo=CALIBRATION.cam_to_velo(two), prompts=(Prompt("Car", (500, 150, 800, 300)),)
    )
    (found,) = select(frame)
    assert isinstance(found, UnusablePrompt)
    assert found.sentence == "Too few LiDAR points inside the 2D box (2, at least 5 are needed)."


def test_only_ground_under_a_prompt_is_no_object() -> None:
    (found,) = select(frame_of([car(3.0, 15.0, -1.4)], [Prompt("Car", (100, 250, 300, 330))]))
    assert isinstance(found, UnusablePrompt)
    assert found.result is Result.TOO_FEW_OBJECT_POINTS
    assert found.counts.in_prompt > 10


def test_largest_cluster_wins_and_noise_never() -> None:
    rng = np.random.default_rng(0)
    small, large = rng.normal(scale=0.2, size=(30, 3)), rng.normal(scale=0.2, size=(50, 3)) + 5
    noise = rng.uniform(20, 90, size=(70, 3))
    member = largest_cluster(np.concatenate([small, large, noise]), PAPER.points)
    assert member.tolist() == [False] * 30 + [True] * 50 + [False] * 70
    assert not largest_cluster(noise, PAPER.points).any()
    assert largest_cluster(np.empty((0, 3)), PAPER.points).shape == (0,)


@pytest.mark.parametrize("side_m", [0.5, 3.0])
def test_a_crowd_is_clustered_as_a_whole_in_bounded_memory(side_m: float) -> None:
    """DBSCAN alone would hold all pairs: gigabytes for 40,000 points in half a metre."""
    rng = np.random.default_rng(0)
    crowd = rng.uniform(0, side_m, size=(40_000, 3))
    member = largest_cluster(np.concatenate([crowd, crowd[:500] + 20]), PAPER.points)
    assert member[:40_000].all()
    assert not member[40_000:].any()


def test_vertical_filters_keep_the_lower_half() -> None:
    cluster = np.zeros((20, 3))
    cluster[:, 1] = [0] * 8 + [3] * 11 + [4]  # y points down: 4 is the lowest point
    assert lower_half(cluster, PAPER.points).sum() == 12  # at or below the median, 3
    assert lower_half(cluster, RELEASE.points).sum() == 12  # at or below the middle of the range, 2
    cluster[8:19, 1] = 1
    assert lower_half(cluster, PAPER.points).sum() == 12  # the median is 1 now
    assert lower_half(cluster, RELEASE.points).all()  # one point would be left: all are kept


def test_a_mask_pixel_is_centred_on_its_coordinates() -> None:
    box = car(3.0, 15.0, -1.4)
    frame = frame_of([box])
    visible = points_in_image(frame)
    (x1, y1, x2, y2) = frame.prompts[0].box_px
    column, row = visible.pixels.T
    inside = (column >= x1) & (column <= x2) & (row >= y1) & (row <= y2)
    ids = np.zeros(IMAGE_SIZE_PX[::-1], dtype=np.uint16)
    ids[200, 680] = 1
    expected = inside & (np.abs(column - 680) <= 0.5) & (np.abs(row - 200) <= 0.5)
    (found,) = select(replace(frame, instance_ids=ids))
    assert found.counts.in_prompt == expected.sum()


def test_a_prompt_whose_mask_is_not_there_says_so() -> None:
    frame = frame_of([car(3.0, 15.0, -1.4)])
    (found,) = select(replace(frame, instance_ids=np.zeros(IMAGE_SIZE_PX[::-1], dtype=np.uint16)))
    assert isinstance(found, UnusablePrompt)
    assert found.result is Result.EMPTY_MASK


def test_sampling_is_seeded_and_without_replacement_in_the_paper() -> None:
    points = face_points(car(0, 10, 0), np.random.default_rng(0), 400)
    once, again = (sample(points, PAPER.points, np.random.default_rng(7)) for _ in range(2))
    assert once.tolist() == again.tolist()
    assert len(np.unique(once, axis=0)) == 100
    assert sample(points[:60], PAPER.points, np.random.default_rng(7)).tolist() == points[:60].tolist()
    with_replacement = sample(points[:60], RELEASE.points, np.random.default_rng(7))
    assert len(with_replacement) == 100 > len(np.unique(with_replacement, axis=0))
