from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from boxlift import Boxes3D, Calibration
from boxlift.camera import Floats
from boxlift.network.detections import CLASSES
from boxlift.network.geometry import FEATURES, Geometry, GroundLine, describe, ground_line, typical_sizes
from boxlift.priors import SIZE_PRIORS

P = np.array([[720.0, 0, 610, 0], [0, 720, 175, 0], [0, 0, 1, 0]])
SIZE_PX = (1242.0, 375.0)
DEPTHS_M = (8.0, 12.0, 17.0, 25.0, 33.0, 45.0)
BOXES_PX = ((100.0, 170.0, 260.0, 250.0), (600.0, 175.0, 640.0, 205.0), (800.0, 160.0, 830.0, 240.0))


def _described(
    boxes_px: Sequence[Sequence[float]] | Floats,
    categories: Sequence[int],
    image_P_cam: Floats = P,
    size_px: tuple[float, float] = SIZE_PX,
    scores: Sequence[float] | None = None,
) -> Geometry:
    """describe in double precision."""
    return describe(
        torch.tensor(np.asarray(boxes_px)).double().reshape(-1, 4),
        torch.tensor(categories, dtype=torch.int64),
        torch.tensor([0.5] * len(categories) if scores is None else scores).double(),
        torch.tensor(image_P_cam).double(),
        (torch.tensor(size_px[0]).double(), torch.tensor(size_px[1]).double()),
    )


def _line(
    pitch: float, camera_height_m: float, cars: int = len(DEPTHS_M), spread: float = 0.0
) -> tuple[Tensor, Tensor]:
    """Bottoms and 1 / depth of cars on a road seen by such a camera; their heights differ by `spread`."""
    places = np.linspace(0, len(DEPTHS_M) - 1, cars)
    inverse_depth = 1 / torch.from_numpy(np.interp(places, range(len(DEPTHS_M)), DEPTHS_M))
    off = torch.from_numpy(np.random.default_rng(0).normal(0, spread, cars))
    return pitch + camera_height_m * inverse_depth, inverse_depth * (1 + off)


def _fitted(bottom: Tensor, inverse_depth: Tensor, trust: float = 1.0) -> GroundLine:
    return ground_line(bottom, inverse_depth, torch.full_like(bottom, trust))


@pytest.mark.parametrize("pitch", [-0.02, 0.0, 0.015])
@pytest.mark.parametrize("camera_height_m", [1.5, 1.65, 1.8])
@pytest.mark.parametrize(("cars", "pitch_off", "height_off_m"), [(6, 0.006, 0.11), (80, 0.002, 0.05)])
def test_ground_line_recovers_pitch_and_camera_height(
    pitch: float, camera_height_m: float, cars: int, pitch_off: float, height_off_m: float
) -> None:
    """A few cars pull the prior near the truth, many leave little of it."""
    line = _fitted(*_line(pitch, camera_height_m, cars, spread=0.05 if cars > 6 else 0.0))
    assert float(line.pitch) == pytest.approx(pitch, abs=pitch_off)
    assert float(line.camera_height_m) == pytest.approx(camera_height_m, abs=height_off_m)
    # It says how far off it may be.
    assert float(line.pitch_variance) < pitch_off**2
    assert float(line.height_variance) < height_off_m**2


@pytest.mark.parametrize("cars", [0, 6])
def test_ground_line_without_trusted_cars_is_the_prior(cars: int) -> None:
    bottom, inverse_depth = (values[:cars] for values in _line(0.02, 2.5))
    line = _fitted(bottom, inverse_depth, trust=0.0)
    assert [float(value) for value in line] == pytest.approx([0, 1.65, 0.015**2, 0.15**2])


@pytest.mark.parametrize("index", range(len(DEPTHS_M)))
@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_one_outlier_hardly_moves_the_ground_line(index: int, factor: float) -> None:
    """A car half hidden, or two taken for one: less than what the line is unsure of anyway."""
    bottom, inverse_depth = _line(0.01, 1.6)
    clean = _fitted(bottom, inverse_depth)
    inverse_depth[index] *= factor
    line = _fitted(bottom, inverse_depth)
    assert abs(float(line.pitch - clean.pitch)) < 1.2 * float(clean.pitch_variance.sqrt())
    assert abs(float(line.camera_height_m - clean.camera_height_m)) < float(clean.height_variance.sqrt())


@settings(deadline=None, max_examples=50)
@given(
    st.lists(st.tuples(st.floats(-0.2, 0.5), st.floats(0.01, 0.5), st.floats(0, 1)), max_size=8),
)
def test_ground_line_is_finite_and_knows_no_order(cars: list[tuple[float, float, float]]) -> None:
    table = torch.tensor(cars, dtype=torch.float64).reshape(-1, 3)
    line = ground_line(*table.unbind(1))
    assert all(torch.isfinite(value) for value in line)
    assert float(line.pitch_variance) > 0
    assert float(line.height_variance) > 0
    backwards = ground_line(*table.flip(0).unbind(1))
    torch.testing.assert_close(torch.stack(list(line)), torch.stack(list(backwards)))


@settings(deadline=None, max_examples=50)
@given(st.floats(0.3, 4), st.floats(0.3, 4), st.floats(0, 300), st.floats(0, 100))
def test_means_the_same_through_any_lens(across: float, down: float, right: float, below: float) -> None:
    """Focal lengths and principal point change with the boxes: another lens, or a resized image."""
    in_image = np.array([[across, 0, right], [0, down, below], [0, 0, 1]])
    boxes_px = np.array(BOXES_PX) * [across, down, across, down] + [right, below, right, below]
    # No border is near, here or there: that alone is told in pixels.
    first = _described(BOXES_PX, [0, 0, 2], size_px=(1e5, 1e5))
    moved = _described(boxes_px, [0, 0, 2], in_image @ P, size_px=(1e5, 1e5))
    torch.testing.assert_close(moved.features, first.features, rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(moved.depth_m, first.depth_m, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("factor", [2, 3])
def test_means_the_same_in_a_resized_image(factor: int) -> None:
    """Boxes at the border are at the border of the larger image, too."""
    boxes_px = [*BOXES_PX, (0.0, 180.0, 90.0, 300.0), (1100.0, 180.0, 1241.0, 374.0)]
    categories = [0, 0, 2, 0, 0]
    resizing = np.array([[factor, 0, (factor - 1) / 2], [0, factor, (factor - 1) / 2], [0, 0, 1]])
    first = _described(boxes_px, categories)
    size_px = (factor * SIZE_PX[0], factor * SIZE_PX[1])
    resized = _described(np.array(boxes_px) * factor + (factor - 1) / 2, categories, resizing @ P, size_px)
    torch.testing.assert_close(resized.features, first.features)
    torch.testing.assert_close(resized.depth_m, first.depth_m)


def test_typical_sizes_are_those_of_accurate() -> None:
    sizes = dict(zip(CLASSES, typical_sizes().tolist(), strict=True))
    first = SIZE_PRIORS["Car"].templates[0]
    assert sizes["Car"] == pytest.approx([first.length_m, first.width_m, first.height_m])
    prior = SIZE_PRIORS["Pedestrian"]
    assert sizes["Pedestrian"] == pytest.approx([prior.length_m, prior.width_m, prior.height_m])


@pytest.mark.parametrize(
    ("camera_height_m", "depth_m", "off"),
    [
        # The roof at the height of the camera: nothing of the far end is seen above the near one.
        (1.49, 12.0, 0.02),
        (1.49, 20.0, 0.02),
        (1.49, 60.0, 0.02),
        (1.65, 30.0, 0.02),
        (1.65, 60.0, 0.02),
        # From above, the roof's far edge makes a box taller, and the car nearer.
        (1.65, 12.0, 0.05),
    ],
)
@pytest.mark.parametrize("x_m", [-3.0, 0.0, 2.0])
def test_depth_of_a_typical_car_seen_from_behind(
    camera_height_m: float, depth_m: float, off: float, x_m: float
) -> None:
    found = _described(_standing(0, (x_m, depth_m), camera_height_m), [0])
    assert float(found.depth_m[0]) == pytest.approx(depth_m, rel=off)


@pytest.mark.parametrize("name", ["Pedestrian", "Cyclist", "Truck"])
def test_depth_of_other_classes(name: str) -> None:
    category = CLASSES.index(name)
    found = _described(_standing(category, (1.0, 30.0), 1.65), [category])
    assert float(found.depth_m[0]) == pytest.approx(30, rel=0.02)


def _standing(category: int, place_xz_m: tuple[float, float], camera_height_m: float) -> Floats:
    """(1, 4) the 2D box of a typical member of a class, heading away from the camera."""
    length, width, height = (np.array([side]) for side in typical_sizes()[category].double().tolist())
    center = np.array([[place_xz_m[0], camera_height_m - height[0] / 2, place_xz_m[1]]])
    box = Boxes3D(center, length, width, height, np.array([-np.pi / 2]))
    return box.project(Calibration(P, np.eye(4)))


def test_only_whole_cars_tell_of_the_ground() -> None:
    """A truck, a person or a cut car leaves the ground line where the prior has it: columns 9 and 10."""
    cut = (0.0, 180.0, 90.0, 374.0)
    for boxes_px, categories in (([BOXES_PX[0]], [1]), ([BOXES_PX[2]], [2]), ([cut], [0])):
        features = _described(boxes_px, categories).features
        assert features[0, 9:11].abs().max() < 1e-12
    assert _described([BOXES_PX[1]], [0]).features[0, 9:11].abs().max() > 1e-3


def test_columns() -> None:
    """Borders, score and class are where they are looked for, and nothing depends on other boxes' order."""
    boxes_px = [(0.0, 180.0, 90.0, 300.0), (1100.0, 180.0, 1241.0, 300.0), (600.0, 180.0, 700.0, 374.0)]
    scores = [0.4, 0.9, 0.6]
    found = _described(boxes_px, [0, 1, 3], scores=scores)
    assert found.features.shape == (3, FEATURES)
    assert found.features[:, 13:16].tolist() == np.eye(3).tolist()
    assert found.features[:, 16].tolist() == pytest.approx([0.0, 1.0, 0.4], abs=1e-6)
    assert found.features[:, 17:].argmax(1).tolist() == [0, 1, 3]
    backwards = _described(boxes_px[::-1], [3, 1, 0], scores=scores[::-1])
    torch.testing.assert_close(backwards.features.flip(0), found.features)


@pytest.mark.parametrize(
    "box_px", [(600.0, 50.0, 640.0, 60.0), (610.0, 175.0, 610.0, 175.0), (0.0, 0.0, 1241.0, 374.0)]
)
def test_odd_boxes_are_finite(box_px: tuple[float, float, float, float]) -> None:
    """Above the horizon, without area, or the whole image."""
    found = _described([box_px], [0])
    assert torch.isfinite(found.features).all()
    assert 0 < float(found.depth_m[0]) < 1000


def test_no_boxes() -> None:
    found = _described(np.empty((0, 4)), [])
    assert (found.features.shape, found.depth_m.shape) == ((0, FEATURES), (0,))
