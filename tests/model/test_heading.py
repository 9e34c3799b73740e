from __future__ import annotations

import numpy as np
import pytest

from boxlift.heading import facing_away, heading_hypotheses, main_direction, resolve_heading
from boxlift.settings import PAPER, RELEASE
from model.small_frame import car, face_points


def line(direction_rad: float, length_m: float = 3.0) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Points along a line whose rotation_y is `direction_rad`: the heading is (cos, -sin) in (x, z)."""
    along = np.linspace(-length_m / 2, length_m / 2, 40)
    return np.stack([along * np.cos(direction_rad), np.ones(40), 15 - along * np.sin(direction_rad)], axis=1)


@pytest.mark.parametrize("rotation_y", [0.1, 0.7, 1.4, 2.2, 3.0])
def test_direction_has_the_sign_of_rotation_y(rotation_y: float) -> None:
    assert main_direction(line(rotation_y), PAPER.heading) == pytest.approx(rotation_y, abs=1e-6)


@pytest.mark.parametrize(("rotation_y", "rounded"), [(0.12, 0.1), (0.17, 0.2), (1.44, 1.4), (3.13, 3.1)])
def test_release_rounds_the_direction(rotation_y: float, rounded: float) -> None:
    assert main_direction(line(rotation_y), RELEASE.heading) == pytest.approx(rounded)


def test_the_side_with_more_points_decides_between_two() -> None:
    points = np.concatenate([line(0.5, 4.0), line(0.5 + np.pi / 2, 1.0)[:8]])
    assert main_direction(points, PAPER.heading) == pytest.approx(0.5, abs=0.05)


def test_points_in_one_place_have_no_direction_but_an_answer() -> None:
    assert main_direction(np.ones((5, 3)), PAPER.heading) == pytest.approx(np.pi / 2)
    assert main_direction(np.ones((1, 3)), PAPER.heading) == pytest.approx(np.pi / 2)


@pytest.mark.parametrize(
    ("direction", "x_extent_m", "expected"),
    [
        # Equation 7: a narrow object heads along the viewing direction, folded to (pi/4, 3 pi/4) ...
        (1.6, 1.8, 1.6),
        (0.1, 1.8, 0.1 + np.pi / 2),
        (3.0, 1.8, 3.0 - np.pi / 2),
        # ... and one wider than C = 3 m across it.
        (1.6, 3.5, 1.6 - np.pi / 2),
        (1.5, 3.5, 1.5 + np.pi / 2),
        (0.1, 3.5, 0.1),
    ],
)
def test_equation_7(direction: float, x_extent_m: float, expected: float) -> None:
    chosen, perpendicular = resolve_heading(direction, x_extent_m, PAPER.heading)
    assert chosen == pytest.approx(expected)
    assert abs(chosen - perpendicular) == pytest.approx(np.pi / 2)


def test_release_folds_wider_and_needs_four_metres() -> None:
    assert resolve_heading(0.5, 3.5, RELEASE.heading)[0] == pytest.approx(0.5)
    assert resolve_heading(0.2, 3.5, RELEASE.heading)[0] == pytest.approx(0.2 + np.pi / 2)
    assert resolve_heading(0.2, 4.5, RELEASE.heading)[0] == pytest.approx(0.2)


def test_unknown_front_faces_away_from_the_camera() -> None:
    for angle in np.linspace(0, np.pi, 7, endpoint=False):
        heading_z = -np.sin(facing_away(float(angle)))
        assert heading_z >= 0


@pytest.mark.parametrize("rotation_y", [-1.5, -1.35])
def test_a_car_ahead_seen_from_behind_and_a_side(rotation_y: float) -> None:
    points = face_points(car(4.0, 14.0, rotation_y), np.random.default_rng(2), 100)
    chosen, rejected = heading_hypotheses(points, points, PAPER.heading)
    assert chosen.rotation_y == pytest.approx(rotation_y, abs=0.06)
    assert "along x" in rejected.reason
