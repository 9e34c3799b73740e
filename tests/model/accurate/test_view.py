from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from boxlift import Prompt
from boxlift.accurate.view import View, region_of
from boxlift.camera import Floats
from boxlift.settings import ACCURATE
from model.accurate.by_hand import unclaimed, view_of
from model.small_frame import CALIBRATION, CAMERA_HEIGHT_M, IMAGE_SIZE_PX, frame_of

# At 18 m, 25 pixels to the metre of depth 18: pixels (610 + 40 x, ...).
PROMPT = Prompt("Car", (570.0, 150.0, 650.0, 245.0))


def at(*x_and_height: tuple[float, float]) -> Floats:
    """(N, 3) points 18 m ahead, at x and height above the ground; 40 pixels to the metre."""
    return np.array([[x, CAMERA_HEIGHT_M - height, 18.0] for x, height in x_and_height])


def test_keeps_what_is_ahead_and_in_the_image_or_a_little_beyond() -> None:
    left_of_the_image_px = -0.2 * IMAGE_SIZE_PX[0]
    kept = np.array([[0, 1.0, 18], [(left_of_the_image_px - 610) / 40, 1.0, 18]])
    dropped = np.array([[0, 1.0, -18], [0, 0, 0.3], [(-0.6 * IMAGE_SIZE_PX[0] - 610) / 40, 1.0, 18]])
    frame = replace(frame_of([]), points_velo=CALIBRATION.cam_to_velo(np.concatenate([kept, dropped])))
    view = View.of(frame, ACCURATE.ground)
    assert view.points_cam == pytest.approx(kept)
    assert view.pixels[:, 0].tolist() == pytest.approx([610, left_of_the_image_px])


def test_the_ground_does_not_depend_on_what_lies_beside_the_image() -> None:
    whole = frame_of([])
    cropped = View.of(whole, ACCURATE.ground)
    inside = ((cropped.pixels >= 0) & (cropped.pixels < IMAGE_SIZE_PX)).all(axis=1)
    crop = replace(whole, points_velo=CALIBRATION.cam_to_velo(cropped.points_cam[inside]))
    x, z = np.array([-3.0, 0, 4]), np.array([10.0, 20, 35])
    assert View.of(crop, ACCURATE.ground).ground.y_at(x, z) == pytest.approx(cropped.ground.y_at(x, z))


def test_inside_are_object_high_points_of_the_prompt_and_around_its_surroundings() -> None:
    points = at((0.0, 0.5), (0.0, 0.1), (0.0, 1.8), (1.4, 0.5), (3.0, 0.5))
    view = view_of(points, [replace(PROMPT, box_px=(570, 100, 650, 245))])
    region = region_of(view, 0, unclaimed(view), height_m=1.7)
    assert region.inside.tolist() == [0]
    assert region.around.tolist() == [0, 3]
    assert region.around_inside.tolist() == [True, False]
    assert (region.in_prompt, region.found) == (3, 1)  # the ground and the branch above it with them
    assert region.width_px == 80


def test_claimed_points_are_left_out_but_told() -> None:
    view = view_of(at((0.0, 0.5), (0.5, 0.5), (1.4, 0.5)), [PROMPT])
    region = region_of(view, 0, np.array([True, False, True]), height_m=1.7)
    assert region.inside.tolist() == region.around.tolist() == [1]
    assert (region.in_prompt, region.found) == (2, 1)


def test_a_mask_decides_what_is_inside() -> None:
    view = view_of(at((-0.5, 0.5), (0.5, 0.5)), [PROMPT])
    ids = np.zeros(IMAGE_SIZE_PX[::-1], dtype=np.uint8)
    ids[:, :610] = 1
    masked = replace(view, frame=replace(view.frame, instance_ids=ids))
    region = region_of(masked, 0, unclaimed(view), height_m=1.7)
    assert region.inside.tolist() == [0]
    assert region.around.tolist() == [0, 1]
    assert region.around_inside.tolist() == [True, False]


def test_beyond_the_image_there_is_no_mask() -> None:
    cut = Prompt("Car", (0, 150, 80, 245))
    view = view_of(at((-14.5, 0.5), (-16.0, 0.5)), [cut])
    assert region_of(view, 0, unclaimed(view), height_m=1.7).inside.tolist() == [0, 1]
    ids = np.ones(IMAGE_SIZE_PX[::-1], dtype=np.uint8)
    masked = replace(view, frame=replace(view.frame, instance_ids=ids))
    assert region_of(masked, 0, unclaimed(view), height_m=1.7).inside.tolist() == [0]


@pytest.mark.parametrize(
    ("box_px", "x", "is_inside"),
    [
        ((0, 150, 80, 245), -16.0, True),  # cut on the left: 30 pixels left of the image
        ((20, 150, 80, 245), -16.0, False),  # not cut
        ((1160, 150, 1241, 245), 16.5, True),  # cut on the right
        ((1160, 150, 1241, 245), -16.0, False),  # the other side
    ],
)
def test_a_prompt_that_the_border_cuts_goes_on_beyond_it(
    box_px: tuple[float, float, float, float], x: float, is_inside: bool
) -> None:
    view = view_of(at((x, 0.5)), [Prompt("Car", box_px)])
    assert len(region_of(view, 0, unclaimed(view), height_m=1.7).inside) == is_inside


def test_the_box_of_a_region_is_cut_to_the_image() -> None:
    view = view_of(at((0.0, 0.5)), [Prompt("Car", (-50, 150, 2000, 900))])
    region = region_of(view, 0, unclaimed(view), height_m=1.7)
    assert region.box_px.tolist() == [0, 150, 1241, 374]
    assert region.cut.tolist() == [True, False, True, True]
    assert region.may_hide


@pytest.mark.parametrize(
    ("other", "may_hide"),
    [
        (Prompt("Car", (620.0, 160.0, 700.0, 260.0)), True),  # reaches lower and covers a third
        (Prompt("Car", (620.0, 160.0, 700.0, 240.0)), False),  # farther away
        (Prompt("Car", (660.0, 160.0, 740.0, 260.0)), False),  # beside it
    ],
)
def test_a_nearer_prompt_over_it_may_hide_a_part(other: Prompt, may_hide: bool) -> None:
    view = view_of(at((0.0, 0.5)), [PROMPT, other])
    assert region_of(view, 0, unclaimed(view), height_m=1.7).may_hide == may_hide


def test_of_many_points_a_sample_speaks_always_the_same() -> None:
    rng = np.random.default_rng(0)
    points = at(*zip(rng.uniform(-0.9, 0.9, 1000), rng.uniform(0.3, 1.5, 1000), strict=True))
    view = view_of(points, [PROMPT, PROMPT])
    first, again, other = (region_of(view, i, unclaimed(view), height_m=1.7) for i in (0, 0, 1))
    assert first.found == 1000
    assert (len(first.inside), len(first.around)) == (160, 320)
    assert (np.diff(first.inside) > 0).all()
    assert first.inside.tolist() == again.inside.tolist()
    assert first.around.tolist() == again.around.tolist()
    assert first.inside.tolist() != other.inside.tolist()
