"""The fit finds the global minimum, the same in every batch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from boxlift.camera import Floats
from boxlift.fit import FitProblem, fit_boxes
from boxlift.losses import BevBoxes, balanced_loss
from boxlift.settings import PAPER, RELEASE, FitSettings, LabellerSettings

ADAM = FitSettings(method="adam", adam_steps=300)


def visible_faces(
    center_xz: tuple[float, float],
    rotation_y: float,
    count: int,
    seed: int,
    length: float = 4.0,
    width: float = 1.8,
) -> Floats:
    """Points (count, 2) on the two sides of a box that face the origin, with 2 cm of noise."""
    rng = np.random.default_rng(seed)
    along = np.array([np.cos(rotation_y), -np.sin(rotation_y)])
    across = np.array([np.sin(rotation_y), np.cos(rotation_y)])
    center = np.array(center_xz)
    end = -np.sign(along @ center) * along * length / 2
    side = -np.sign(across @ center) * across * width / 2
    share = rng.uniform(-1, 1, count)[:, None]
    on_end = rng.uniform(size=count)[:, None] < width / (length + width)
    points = np.where(
        on_end, center + end + share * across * width / 2, center + side + share * along * length / 2
    )
    noisy: Floats = points + rng.normal(scale=0.02, size=(count, 2))
    return noisy


def problem(center_xz: tuple[float, float], rotation_y: float, count: int = 100, seed: int = 0) -> FitProblem:
    return FitProblem(visible_faces(center_xz, rotation_y, count, seed), 4.0, 1.8, rotation_y, np.zeros(2))


def brute_force(item: FitProblem, settings: LabellerSettings, step_m: float = 0.04) -> float:
    """The lowest loss on a grid over +-4 m around the points."""
    side = torch.arange(-4, 4 + step_m / 2, step_m, dtype=torch.float64)
    points = torch.from_numpy(item.points_xz)
    centers = torch.cartesian_prod(side, side) + points.mean(0)
    length, width, rotation = torch.tensor(
        [item.length_m, item.width_m, item.rotation_y], dtype=torch.float64
    )
    valid, origin = torch.ones(len(points), dtype=torch.bool), torch.from_numpy(item.origin_xz)
    lowest = torch.inf
    for rows in torch.chunk(centers, 8):
        boxes = BevBoxes(rows, length, width, rotation)
        lowest = min(lowest, balanced_loss(points, valid, boxes, origin, settings.loss).min().item())
    return lowest


@pytest.mark.parametrize("rotation_y", [-1.5, -0.8, 0.05, 0.6])
@pytest.mark.parametrize("center_xz", [(0.5, 12.0), (-8.0, 20.0), (15.0, 45.0)])
def test_recovers_a_box_from_its_two_visible_sides(center_xz: tuple[float, float], rotation_y: float) -> None:
    (solution,) = fit_boxes([problem(center_xz, rotation_y)], PAPER.fit, PAPER.loss, pad_to=100)
    assert np.hypot(*(solution.center_xz - center_xz)) < 0.3


@pytest.mark.parametrize("settings", [PAPER, RELEASE], ids=lambda settings: settings.preset)
def test_reaches_the_minimum_of_a_brute_force_grid(settings: LabellerSettings) -> None:
    rng = np.random.default_rng(5)
    problems = [
        problem(
            (rng.uniform(-10, 10), rng.uniform(8, 50)),
            rng.uniform(-np.pi, 0),
            int(rng.integers(10, 100)),
            seed,
        )
        for seed in range(12)
    ]
    solutions = fit_boxes(problems, settings.fit, settings.loss, pad_to=100)
    ratios = [
        solution.losses.total / brute_force(item, settings)
        for item, solution in zip(problems, solutions, strict=True)
    ]
    assert max(ratios) <= 1.01


def test_search_is_never_worse_than_adam() -> None:
    problems = [problem((3.0, 15.0), -0.7, 60, seed) for seed in range(4)]
    found = fit_boxes(problems, PAPER.fit, PAPER.loss, pad_to=100)
    descended = fit_boxes(problems, ADAM, PAPER.loss, pad_to=100)
    for search, adam in zip(found, descended, strict=True):
        assert search.losses.total <= adam.losses.total * 1.001
        assert np.isfinite(adam.losses.total)


def test_adam_descends_from_the_centroid() -> None:
    item = problem((3.0, 15.0), -0.7)
    stay = fit_boxes([item], ADAM.model_copy(update={"adam_steps": 1}), PAPER.loss, pad_to=100)[0]
    moved = fit_boxes([item], ADAM, PAPER.loss, pad_to=100)[0]
    assert moved.losses.total < 0.8 * stay.losses.total


@pytest.mark.parametrize(
    "fit", [PAPER.fit, ADAM.model_copy(update={"adam_steps": 20})], ids=["search", "adam"]
)
def test_neighbours_in_a_batch_do_not_change_an_answer(fit: FitSettings) -> None:
    """To the last bit: the same object alone, among others, and beside one of another size."""
    truck = FitProblem(visible_faces((4, 30), 0.3, 80, 9, 8.5, 2.5), 8.5, 2.5, 0.3, np.zeros(2))
    problems = [problem((2.0, 10.0 + 3 * seed), -1.2, 30 + 9 * seed, seed) for seed in range(6)]
    alone = [fit_boxes([item], fit, PAPER.loss, pad_to=100)[0] for item in problems]
    together = fit_boxes([truck, *problems], fit, PAPER.loss, pad_to=100)[1:]
    for one, other in zip(alone, together, strict=True):
        assert one.center_xz.tolist() == other.center_xz.tolist()
        assert one.losses == other.losses


def test_no_problems_no_solutions() -> None:
    assert fit_boxes([], PAPER.fit, PAPER.loss, pad_to=100) == []


def test_a_search_around_a_start_stays_within_its_reach_and_finds_the_minimum_there() -> None:
    item = problem((2.0, 15.0), -1.2)
    (everywhere,) = fit_boxes([item], FitSettings(), PAPER.loss, 100)
    near = FitSettings(grid_steps=4, reach_m=1.0, beam_width=16, levels=6)
    (found,) = fit_boxes([replace(item, start_xz=everywhere.center_xz + 0.6)], near, PAPER.loss, 100)
    assert found.losses.total == pytest.approx(everywhere.losses.total, rel=0.02)
    far_away = everywhere.center_xz + 10.0
    (elsewhere,) = fit_boxes([replace(item, start_xz=far_away)], near, PAPER.loss, 100)
    assert np.abs(elsewhere.center_xz - far_away).max() < 1.3
