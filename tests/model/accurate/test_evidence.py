from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from boxlift import Calibration, Prompt
from boxlift.accurate.evidence import Evidence, weigh
from boxlift.accurate.parameters import BOTTOM, HEIGHT, LENGTH, YAW, X, Z
from boxlift.accurate.polish import SizePull
from boxlift.accurate.view import region_of
from boxlift.accurate.weights import EVIDENCE_WEIGHTS
from boxlift.camera import Floats
from model.accurate.by_hand import LWH_M, a_box, outline_points, prompt_of, unclaimed, upright, view_of
from model.small_frame import CALIBRATION

SIZE = SizePull(LWH_M, 0.1 * LWH_M)
QUARTER = np.pi / 2
# A car 20 m ahead, seen from behind: from z = 18 to 22, 1.7 m wide, 1.5 m tall.
CAR = a_box(0.0, 20.0, -QUARTER)
EVERYTHING = Prompt("Car", (0.0, 0.0, 1242.0, 375.0))
ON, SHORT, THROUGH = (0.0, 1.0, 18.0), (0.0, 0.9, 10.0), (0.2, 1.4, 30.0)
BESIDE, BEHIND = (5.0, 1.0, 16.0), (5.0, 1.0, 30.0)
ROOF = Calibration(
    CALIBRATION.image_P_cam, np.array([[0.0, -1, 0, 0], [0, 0, -1, -6.0], [1, 0, 0, 0], [0, 0, 0, 1]])
)


def weighed(
    points: Floats,
    boxes: Floats = CAR,
    prompt: Prompt = EVERYTHING,
    calibration: Calibration = CALIBRATION,
    *,
    use_edges: bool = True,
) -> Evidence:
    view = view_of(points, [prompt], calibration)
    region = region_of(view, 0, unclaimed(view), height_m=3.0)
    return weigh(view, region, boxes, SIZE, use_edges=use_edges)


def rays(*points: tuple[float, float, float], calibration: Calibration = CALIBRATION) -> dict[str, float]:
    """The shares of rays that end in some points, those above zero."""
    evidence = weighed(np.array(points), calibration=calibration)
    names = ("on", "short", "through", "beside", "behind")
    return {name: share for name in names if (share := float(getattr(evidence, name)[0]))}


@pytest.mark.parametrize(
    ("point", "name"),
    [(ON, "on"), (SHORT, "short"), (THROUGH, "through"), (BESIDE, "beside"), (BEHIND, "behind")],
)
def test_a_ray_ends_in_one_way(point: tuple[float, float, float], name: str) -> None:
    assert rays(point) == {name: 1.0}


def test_rays_are_shares() -> None:
    assert rays(ON, ON, SHORT, THROUGH) == {"on": 0.5, "short": 0.25, "through": 0.25}


def test_a_ray_over_the_car_or_through_its_windows_says_nothing() -> None:
    assert rays((0.0, 0.5, 30.0)) == {}


def test_a_lidar_on_a_roof_looks_down_over_a_car() -> None:
    """From 6 m higher the ray to the point passes over the roof; lower behind, it meets the boot."""
    assert rays(THROUGH, calibration=ROOF) == {}
    assert rays((0.2, 1.4, 22.5), calibration=ROOF) == {"through": 1.0}
    assert rays(ON, calibration=ROOF) == {"on": 1.0}


def test_corners_are_rounded_for_rays() -> None:
    """Within a twentieth of the width of the corner a ray may pass."""
    assert rays((0.84 * 30 / 20, 1.4, 30.0)).keys() == {"behind"}
    assert rays((0.5 * 30 / 20, 1.4, 30.0)).keys() == {"through"}


def test_a_ray_along_a_side_is_no_division_by_zero() -> None:
    sensor = CALIBRATION.lidar_center_cam
    assert rays((float(sensor[0]), 1.4, 30.0)).keys() == {"through"}


def test_the_exact_box_is_likelier_than_others() -> None:
    truth = a_box()
    worse = [
        np.array([0.8, 0, 0, 0, 0, 0, 0]),  # beside
        np.array([0, 1.2, 0, 0, 0, 0, 0]),  # farther
        np.array([0, -1.2, 0, 0, 0, 0, 0]),  # nearer
        np.array([0, 0, QUARTER, 0, 0, 0, 0]),  # across
        np.array([0, 0, 0.4, 0, 0, 0, 0]),  # turned
        np.array([0, 0, 0, 1.5, 0, 0, 0]),  # too long
        np.array([0, 0, 0, 0, 0, 0.5, 0]),  # too tall
    ]
    boxes = np.concatenate([truth, *(truth + step for step in worse)])
    energy = weighed(upright(outline_points(truth)), boxes, prompt_of(truth)).energy(EVIDENCE_WEIGHTS)
    assert energy.argmin() == 0
    assert np.sort(energy)[1] - energy[0] > 1


def test_the_exact_box_costs_nothing_by_prompt_and_priors() -> None:
    evidence = weighed(upright(outline_points(CAR)), CAR, prompt_of(CAR))
    for name in ("sides", "vertical", "length", "width", "height", "ground", "misfit"):
        assert getattr(evidence, name)[0] == pytest.approx(0, abs=0.01), name
    # Points on the sides that the sensor cannot see would have been seen through the body.
    assert evidence.on[0] > 0.5
    assert evidence.on[0] + evidence.through[0] == pytest.approx(1)
    assert evidence.contained[0] == 1
    assert evidence.spill[0] == 0
    assert evidence.span[0] == pytest.approx(np.log(0.95), abs=0.06)


@pytest.mark.parametrize(
    ("name", "column", "off"),
    [
        ("length", LENGTH, 0.5),
        ("width", 4, 0.3),
        ("height", HEIGHT, -0.3),
        ("ground", BOTTOM, 0.3),
        ("sides", X, 0.5),
        ("vertical", BOTTOM, -0.4),
        ("misfit", X, 0.15),
    ],
)
def test_each_error_shows_in_its_term_and_the_more_the_larger(name: str, column: int, off: float) -> None:
    boxes = np.repeat(CAR, 3, axis=0)
    boxes[:, column] += (0, off / 2, off)
    values = getattr(weighed(upright(outline_points(CAR)), boxes, prompt_of(CAR)), name)
    assert values[0] < values[1] < values[2]


def test_edges_count_only_where_they_are_wanted() -> None:
    off = CAR + 0.5 * np.eye(7)[X]
    points = upright(outline_points(CAR))
    assert weighed(points, off, prompt_of(CAR)).sides[0] > 1
    without = weighed(points, off, prompt_of(CAR), use_edges=False)
    assert (without.sides[0], without.vertical[0]) == (0, 0)


def test_points_that_stand_against_the_box_spill() -> None:
    """A wall half a metre beside the car, in the surroundings of its prompt."""
    wall = np.stack([np.full(30, 1.3), np.linspace(18, 22, 30)], axis=1)
    points = upright(np.concatenate([outline_points(CAR), wall]))
    assert weighed(points, CAR, prompt_of(CAR)).spill[0] > 0.3


def test_points_of_the_box_outside_its_prompt_are_not_contained() -> None:
    """A prompt of the left half; of the right one, a strip is looked at."""
    x1, y1, x2, y2 = prompt_of(CAR).box_px
    half = Prompt("Car", (x1, y1, (x1 + x2) / 2, y2))
    evidence = weighed(upright(outline_points(CAR)), CAR, half)
    assert 0.5 < evidence.contained[0] < 0.85


def test_a_half_turn_changes_nothing() -> None:
    points = upright(outline_points(a_box()))
    both = np.concatenate([a_box(), a_box() + np.pi * np.eye(7)[YAW]])
    first, second = weighed(points, both, prompt_of(a_box())).matrix()
    assert first == pytest.approx(second)


@pytest.mark.parametrize(
    "count",
    [
        100,
        2000,
    ],
)
def test_counts_are_of_all_points_not_of_the_sample(count: int) -> None:
    rng = np.random.default_rng(0)
    points_xz = CAR[0, [X, Z]] + rng.uniform(-0.8, 0.8, (count, 2))
    evidence = weighed(upright(points_xz, [0.5]), CAR, prompt_of(CAR))
    assert np.expm1(evidence.count[0]) == pytest.approx(count, rel=0.1)


def test_energy_is_the_weighted_sum() -> None:
    evidence = weighed(np.array([ON, SHORT]))
    assert evidence.energy({"on": -2.0, "short": 3.0}).tolist() == pytest.approx([0.5])
    assert set(EVIDENCE_WEIGHTS) <= {field.name for field in fields(Evidence)}
