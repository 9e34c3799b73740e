"""Geometry follows the pixels: what is projected after a change lands where the change moved its pixel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from boxlift.boxes import Boxes3D, alpha_from_rotation_y
from boxlift.camera import Floats
from boxlift.network.augmentation import (
    Sample,
    augment,
    change_focal,
    change_scale,
    flip,
    recolor,
)
from boxlift.network.config import AugmentationSettings
from boxlift.network.targets import POINTS, Targets
from model.small_frame import car, face_points

WIDTH, HEIGHT = 621, 188
# KITTI's kind: the camera is beside the origin, and its third row has a small offset.
PROJECTION = np.array([[360.0, 0, 305.3, 22.4], [0, 360, 86.4, 0.1], [0, 0, 1, 0.00275]])
PLACES = ((-4.0, 14.0, -1.5), (3.0, 25.0, 0.4), (1.0, 8.0, -2.9))


def _sample() -> Sample:
    boxes = [car(*place) for place in PLACES]
    points = np.stack([face_points(box, np.random.default_rng(5), POINTS) for box in boxes])
    corners = [_project(PROJECTION, box.corners()[0]) for box in boxes]
    count = len(boxes)
    return Sample(
        image=np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8),
        image_P_cam=PROJECTION,
        lidar_center_cam=np.array([0.1, -0.08, -0.27]),
        boxes_px=np.array([[*c.min(0), *c.max(0)] for c in corners]),
        category=np.zeros(count, dtype=np.int64),
        targets=Targets(
            weight=np.ones(count),
            points_cam=points,
            point_count=np.full(count, POINTS),
            heading=np.array([place[2] for place in PLACES]),
            center_cam=np.concatenate([box.center_cam for box in boxes]),
            size_m=np.tile([4.0, 1.8, 1.6], (count, 1)),
            rotation_y=np.array([place[2] for place in PLACES]),
        ),
    )


def _project(image_P_cam: Floats, points_cam: Floats) -> Floats:
    image = points_cam @ image_P_cam[:, :3].T + image_P_cam[:, 3]
    pixels: Floats = image[..., :2] / image[..., 2:]
    return pixels


def _corners(sample: Sample) -> Floats:
    targets = sample.targets
    length, width, height = targets.size_m.T
    boxes = Boxes3D(targets.center_cam, length, width, height, targets.rotation_y)
    return boxes.corners()


def test_mirror_moves_everything_to_the_other_side() -> None:
    before, after = _sample(), flip(_sample())
    assert (after.image[:, 0] == before.image[:, -1]).all()
    pixels = _project(before.image_P_cam, before.targets.points_cam)
    mirrored = _project(after.image_P_cam, after.targets.points_cam)
    np.testing.assert_allclose(mirrored, [WIDTH - 1, 0] + pixels * [-1, 1], atol=1e-9)
    # The mirrored box is the box of the mirrored corners.
    np.testing.assert_allclose(
        np.sort(_corners(after), axis=1), np.sort(_corners(before) * [-1, 1, 1], axis=1), atol=1e-9
    )
    np.testing.assert_allclose(after.boxes_px[:, 0], WIDTH - 1 - before.boxes_px[:, 2])
    assert after.image_P_cam[0, 0] > 0
    assert after.lidar_center_cam[0] == -0.1


def test_mirror_twice_is_nothing() -> None:
    before, after = _sample(), flip(flip(_sample()))
    assert (after.image == before.image).all()
    np.testing.assert_allclose(after.image_P_cam, before.image_P_cam, atol=1e-12)
    np.testing.assert_allclose(after.targets.points_cam, before.targets.points_cam)


@pytest.mark.parametrize("factor", [0.8, 1.25])
def test_focal_length_moves_pixels_and_nothing_else(factor: float) -> None:
    before, after = _sample(), change_focal(_sample(), factor)
    assert after.image.shape[:2] == (round(HEIGHT * factor), round(WIDTH * factor))
    assert (after.targets.points_cam == before.targets.points_cam).all()
    pixels = _project(before.image_P_cam, before.targets.points_cam)
    across, down = after.image.shape[1] / WIDTH, after.image.shape[0] / HEIGHT
    moved = (pixels + 0.5) * [across, down] - 0.5
    np.testing.assert_allclose(_project(after.image_P_cam, after.targets.points_cam), moved, atol=1e-9)
    np.testing.assert_allclose(after.boxes_px[:, :2], (before.boxes_px[:, :2] + 0.5) * [across, down] - 0.5)
    assert after.image_P_cam[0, 0] == pytest.approx(360 * factor, rel=2e-3)


@pytest.mark.parametrize("factor", [0.8, 1.25])
def test_zoom_takes_centres_to_their_pixels_at_the_same_focal_length(factor: float) -> None:
    before, after = _sample(), change_scale(_sample(), factor)
    assert after.image.shape == before.image.shape
    assert np.diag(after.image_P_cam)[:2] == pytest.approx(360, rel=5e-3)
    z_before, z_after = before.targets.points_cam[..., 2].mean(1), after.targets.points_cam[..., 2].mean(1)
    np.testing.assert_allclose(z_after, z_before / factor, rtol=2e-3)
    # The means of the points, which objects turn about, land exactly where the zoom took them.
    means = [_project(s.image_P_cam, s.targets.points_cam.mean(1)) for s in (before, after)]
    principal = after.image_P_cam[:2, 2], before.image_P_cam[:2, 2]
    np.testing.assert_allclose(
        means[1] - principal[0], (means[0] - principal[1]) * factor, rtol=3e-3, atol=0.6
    )
    # Every point lands near it: perspective within an object changes with distance.
    points = [_project(s.image_P_cam, s.targets.points_cam) for s in (before, after)]
    moved = (points[0] - principal[1]) * factor + principal[0]
    extent = (before.boxes_px[:, 2:] - before.boxes_px[:, :2]).max(1) * factor
    assert (np.abs(points[1] - moved).max((1, 2)) < 0.1 * extent).all()


def test_zoom_shows_the_same_sides() -> None:
    before, after = _sample(), change_scale(_sample(), 1.25)
    views = [alpha_from_rotation_y(s.targets.heading, s.targets.points_cam.mean(1)) for s in (before, after)]
    np.testing.assert_allclose(views[0], views[1], atol=1e-9)
    distance = [
        np.linalg.norm(s.targets.points_cam - s.targets.center_cam[:, None], axis=-1) for s in (before, after)
    ]
    np.testing.assert_allclose(distance[0].mean(1), distance[1].mean(1), rtol=0.1)


def test_zoom_leaves_out_what_it_pushes_out_of_the_image() -> None:
    sample = _sample()
    edge = replace(sample, boxes_px=np.array([[0.0, 60, 40, 120], *sample.boxes_px[1:]]))
    assert change_scale(edge, 1.9).targets.weight.tolist() == [0, 1, 1]


def test_picture_of_a_zoom_is_where_the_projection_says() -> None:
    image = np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)
    center = _sample().targets.points_cam.mean(1)[0]
    column, row = _project(PROJECTION, center).round().astype(int)
    image[row - 2 : row + 3, column - 2 : column + 3] = 255
    for change in (flip, lambda s: change_scale(s, 1.2), lambda s: change_focal(s, 0.9)):
        after = change(replace(_sample(), image=image))
        seen = np.argwhere(after.image[..., 0] > 100).mean(0)[::-1]
        expected = _project(after.image_P_cam, after.targets.points_cam[0].mean(0))
        assert np.abs(seen - expected).max() < 1.5


def test_colours_change_and_geometry_does_not() -> None:
    before = _sample()
    after = augment(before, AugmentationSettings(color=0.4), np.random.default_rng(1))
    assert (after.image != before.image).any()
    assert after.targets is before.targets
    assert (recolor(before.image, 1, 1, 1) == before.image).all()
    gray = recolor(before.image, 1, 1, 0)
    assert np.ptp(gray.astype(int), axis=2).max() <= 1


def test_no_settings_change_nothing_and_a_seed_repeats() -> None:
    before = _sample()
    assert augment(before, AugmentationSettings(), np.random.default_rng(1)) is before
    everything = AugmentationSettings(flip=0.5, focal=0.2, scale=0.2, color=0.3)
    first, second = (augment(before, everything, np.random.default_rng(3)) for _ in range(2))
    assert (first.image == second.image).all()
    assert (first.targets.points_cam == second.targets.points_cam).all()
