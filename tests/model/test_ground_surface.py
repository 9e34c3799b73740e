from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from boxlift.camera import Floats
from boxlift.ground import Ground, GroundPlane, find_ground
from boxlift.ground_surface import GroundSurface, fit_surface
from boxlift.settings import ACCURATE
from model.small_frame import CAMERA_HEIGHT_M

SETTINGS = ACCURATE.ground
LEVEL = GroundPlane(np.array([0.0, -1.0, 0.0]), CAMERA_HEIGHT_M)
# Where cars stand; ground is given farther than that.
X, Z = (axis.ravel() for axis in np.meshgrid(np.linspace(-8.0, 8, 9), np.linspace(8.0, 36, 12)))


def road(height_m: Floats, x: Floats, z: Floats) -> Floats:
    """(N, 3) points at heights above the level plane."""
    return np.stack([x, CAMERA_HEIGHT_M - height_m, z], axis=1)


def scattered(count: int = 8000, farthest_m: float = 44) -> tuple[Floats, Floats]:
    rng = np.random.default_rng(0)
    return rng.uniform(-14, 14, count), rng.uniform(4, farthest_m, count)


def surface_of(points_cam: Floats) -> GroundSurface:
    return fit_surface(points_cam, LEVEL.height_above(points_cam), SETTINGS)


def slope(x: Floats, z: Floats) -> Floats:
    return 0.03 * (z - 20) + 0.01 * x


def crest(_x: Floats, z: Floats) -> Floats:
    return 0.6 - 0.0015 * (z - 22) ** 2


def valley(_x: Floats, z: Floats) -> Floats:
    return 0.0012 * (z - 22) ** 2 - 0.3


@pytest.mark.parametrize("shape", [slope, crest, valley])
def test_follows_the_road(shape: Callable[[Floats, Floats], Floats]) -> None:
    x, z = scattered()
    surface = surface_of(road(shape(x, z), x, z))
    assert surface.height_at(X, Z) == pytest.approx(shape(X, Z), abs=0.06)
    assert surface.is_known(X, Z).all()


def test_a_kerb_stays_a_step() -> None:
    """0.12 m: both sides are ground, and a stride away from it the surface is level."""
    x, z = scattered()
    surface = surface_of(road(np.where(x > 4, 0.12, 0.0), x, z))
    assert surface.height_at(X, Z)[X < 1] == pytest.approx(0.0, abs=0.03)
    assert surface.height_at(X, Z)[X > 7] == pytest.approx(0.12, abs=0.03)
    assert surface.is_known(X, Z).all()


@pytest.mark.parametrize(("long_m", "wide_m", "tall_m"), [(4.2, 1.8, 1.45), (8.0, 7.0, 1.2)])
def test_vehicles_do_not_lift_the_ground_under_them(long_m: float, wide_m: float, tall_m: float) -> None:
    """A car, and a block of cars so wide that whole cells hold nothing but roofs."""
    x, z = scattered()
    under = (np.abs(x - 3) < wide_m / 2) & (np.abs(z - 20) < long_m / 2)
    surface = surface_of(road(slope(x, z) + np.where(under, tall_m, 0.0), x, z))
    assert surface.height_at(X, Z) == pytest.approx(slope(X, Z), abs=0.1)
    below = np.array([3.0]), np.array([20.0])
    assert surface.height_at(*below) == pytest.approx(slope(*below), abs=0.1)


def test_without_points_it_is_the_plane_and_nothing_is_known() -> None:
    surface = surface_of(np.empty((0, 3)))
    assert not surface.height_at(X, Z).any()
    assert not surface.is_known(X, Z).any()


def test_ground_is_known_where_it_was_seen_and_a_cell_further() -> None:
    x, z = scattered(farthest_m=24)
    surface = surface_of(road(np.zeros(8000), x, z))
    assert surface.is_known(np.zeros(2), np.array([10.0, 23.0])).all()
    assert not surface.is_known(np.zeros(2), np.array([30.0, 60.0])).any()


def test_beyond_the_grid_nothing_is_known_and_the_height_is_finite() -> None:
    x, z = scattered()
    surface = surface_of(road(slope(x, z), x, z))
    far_x, far_z = np.array([0.0, -1e6, 1e6, 0.0]), np.array([1e6, 20.0, 20.0, -1e6])
    assert np.isfinite(surface.height_at(far_x, far_z)).all()
    assert not surface.is_known(far_x, far_z).any()


def test_between_the_centres_of_cells_it_is_bilinear() -> None:
    height = np.zeros((60, 46))
    height[30, 10] = 1.0
    surface = GroundSurface(height, np.ones((60, 46), dtype=np.bool_), 2.0)
    x, z = np.array([1.0, 2.0, 2.0, 3.0]), np.array([17.0, 17.0, 18.0, 17.0])
    assert surface.height_at(x, z).tolist() == pytest.approx([1.0, 0.5, 0.25, 0.0])


@pytest.mark.parametrize("cell_m", [0.5, 2.0, 5.0, 10.0])
def test_on_a_slope_it_lies_low_by_no_more_than_a_cell_falls(cell_m: float) -> None:
    """The lowest point of a cell is half a cell downhill from its centre."""
    x, z = scattered(20_000)
    points_cam = road(slope(x, z), x, z)
    settings = SETTINGS.model_copy(update={"cell_m": cell_m})
    surface = fit_surface(points_cam, LEVEL.height_above(points_cam), settings)
    near = (np.abs(X) < 5) & (Z < 30)
    low_m = slope(X[near], Z[near]) - surface.height_at(X[near], Z[near])
    assert low_m.min() > -0.05
    assert low_m.max() < 0.05 + 0.03 * cell_m


def test_the_ground_of_a_frame_is_plane_and_surface() -> None:
    x, z = scattered()
    car = (np.abs(x - 3) < 0.9) & (np.abs(z - 20) < 2.1)
    height = crest(x, z) + np.where(car, 1.0, 0.0)
    ground = find_ground(road(height, x, z), "frame", SETTINGS)
    assert ground.surface is not None
    assert ground.height_above(road(crest(X, Z) + 0.7, X, Z)) == pytest.approx(0.7, abs=0.08)
    assert ground.y_at(X, Z) == pytest.approx(CAMERA_HEIGHT_M - crest(X, Z), abs=0.08)
    assert ground.is_known(X, Z).all()
    assert ground.is_ground[~car].mean() > 0.99
    assert not ground.is_ground[car].any()


def test_what_stands_at_the_height_of_the_ground_is_zero_above_it() -> None:
    """`y_at` and `height_above` are of the same ground, tilted as it may be."""
    tilted = GroundPlane(np.array([0.02, -1.0, 0.05]) / np.linalg.norm([0.02, -1.0, 0.05]), 1.7)
    x, z = scattered()
    surface = surface_of(road(slope(x, z), x, z))
    for ground in (
        Ground(np.empty(0, dtype=np.bool_), tilted),
        Ground(np.empty(0, dtype=np.bool_), tilted, surface),
        Ground(np.empty(0, dtype=np.bool_), None),
    ):
        standing = np.stack([X, ground.y_at(X, Z), Z], axis=1)
        assert ground.height_above(standing) == pytest.approx(0.0, abs=1e-9)


def test_without_a_plane_the_camera_stands_where_a_car_carries_it_and_nothing_is_known() -> None:
    ground = find_ground(np.empty((0, 3)), "frame", SETTINGS)
    assert ground.y_at(X, Z) == pytest.approx(1.65)
    assert not ground.is_known(X, Z).any()


def test_a_plane_alone_is_known_everywhere() -> None:
    assert Ground(np.empty(0, dtype=np.bool_), LEVEL).is_known(X, Z).all()
