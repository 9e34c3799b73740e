"""Optimisation-only fit: with size and heading frozen, find the (x, z) that minimises the balanced loss.

The loss has several minima per object (either side of the points, and jumps where rays begin to hit),
so one descent from one start does not do. It is cheap, so the default searches the whole plane around
the points: a coarse grid, then ever finer ones around its best local minima.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from boxlift.camera import Floats
from boxlift.frame import LossTerms
from boxlift.losses import BalancedLoss, BevBoxes, balanced_loss, point_density
from boxlift.settings import FitSettings, LossSettings

# Beyond half the box's diagonal from the mean of its points a centre only gets worse; this is slack.
_SEARCH_MARGIN_M = 1.0
# Objects searched in one tensor expression: enough to fill a vector unit, few enough to stay in cache.
_CHUNK = 8


@dataclass(frozen=True)
class FitProblem:
    """One object with one hypothesis of its heading.

    points_xz: (M, 2) object-LiDAR-points, rectified camera frame. origin_xz: (2,) where the rays start.
    """

    points_xz: Floats
    length_m: float
    width_m: float
    rotation_y: float
    origin_xz: Floats


@dataclass(frozen=True)
class FitSolution:
    """The centre (x, z) at the minimum, and the loss there."""

    center_xz: Floats
    losses: LossTerms


@dataclass(frozen=True)
class _Batch:
    """B problems as tensors: points (B, M, 2) around each object's own anchor, padded to a common M."""

    points_xz: Tensor
    valid: Tensor
    density: Tensor
    anchor_xz: Tensor
    origin_xz: Tensor
    length: Tensor
    width: Tensor
    rotation_y: Tensor
    settings: LossSettings

    def loss(self, center_xz: Tensor) -> BalancedLoss:
        """Centres (..., B, 2), relative to the anchors -> the balanced loss (..., B)."""
        # The depth rule of `release` looks at absolute depth, so shift points and camera, not the box.
        anchor = self.anchor_xz
        boxes = BevBoxes(center_xz + anchor, self.length, self.width, self.rotation_y)
        return balanced_loss(
            self.points_xz + anchor[:, None], self.valid, boxes, self.origin_xz, self.settings, self.density
        )


def fit_boxes(
    problems: Sequence[FitProblem], settings: FitSettings, loss: LossSettings, pad_to: int
) -> list[FitSolution]:
    """Fit all problems, in batches; the answer to one does not depend on the others.

    `pad_to` is the number of points that every problem is padded to (the sample count): a fixed shape
    keeps the order of summation, and so the last bit, the same in every batch.
    """
    minimise = _search if settings.method == "search" else _adam
    solutions: list[FitSolution] = []
    for start in range(0, len(problems), _CHUNK):
        batch = _stack(problems[start : start + _CHUNK], loss, pad_to)
        with torch.set_grad_enabled(settings.method == "adam"):
            center = minimise(batch, settings).detach()
        with torch.no_grad():
            terms = batch.loss(center)
        for centre_xz, *values in zip((center + batch.anchor_xz).numpy(), *terms, strict=True):
            total, geometric, ray, central = (float(value) for value in values)
            solutions.append(FitSolution(centre_xz, LossTerms(geometric, ray, central, total)))
    return solutions


def _stack(problems: Sequence[FitProblem], loss: LossSettings, pad_to: int) -> _Batch:
    pad_to = max(pad_to, *(len(problem.points_xz) for problem in problems))
    points = np.zeros((len(problems), pad_to, 2))
    valid = np.zeros((len(problems), pad_to), dtype=np.bool_)
    anchors = np.stack([problem.points_xz.mean(axis=0) for problem in problems])
    for row, problem in enumerate(problems):
        count = len(problem.points_xz)
        points[row, :count] = problem.points_xz - anchors[row]
        valid[row, :count] = True
    points_xz, is_valid = torch.from_numpy(points), torch.from_numpy(valid)

    def column(name: str) -> Tensor:
        return torch.tensor([getattr(problem, name) for problem in problems], dtype=torch.float64)

    return _Batch(
        points_xz=points_xz,
        valid=is_valid,
        density=point_density(points_xz, is_valid, loss.density_radius_m),
        anchor_xz=torch.from_numpy(anchors),
        origin_xz=torch.from_numpy(np.stack([problem.origin_xz for problem in problems])),
        length=column("length_m"),
        width=column("width_m"),
        rotation_y=column("rotation_y"),
        settings=loss,
    )


def _search(batch: _Batch, settings: FitSettings) -> Tensor:
    """Global minimum (B, 2) by a coarse grid and refinement of its best local minima."""
    reach = torch.hypot(batch.length, batch.width) / 2 + _SEARCH_MARGIN_M
    side = torch.linspace(-1, 1, 2 * settings.grid_steps + 1, dtype=torch.float64)
    grid = torch.cartesian_prod(side, side)[:, None]
    centers = grid * reach[:, None]
    lowest = _local_minima(batch.loss(centers).total, len(side))
    starts = lowest.topk(settings.candidates, dim=0, largest=False).indices
    best = centers.gather(0, starts[..., None].expand(-1, -1, 2))

    step = reach / settings.grid_steps
    near = torch.linspace(-1, 1, 5, dtype=torch.float64)
    pattern = torch.cartesian_prod(near, near)[:, None, None]
    while bool((step > settings.final_step_m).any()):
        around = best + pattern * step[:, None]
        chosen = batch.loss(around).total.argmin(0)
        best = around.gather(0, chosen[None, ..., None].expand(-1, -1, -1, 2))[0]
        step = step / 2
    winner = batch.loss(best).total.argmin(0)
    return best.gather(0, winner[None, :, None].expand(-1, -1, 2))[0]


def _local_minima(total: Tensor, side: int) -> Tensor:
    """Loss on the grid (side * side, B) with every cell that has a lower neighbour set to infinity."""
    plane = total.T.reshape(-1, 1, side, side)
    lowest_near = -torch.nn.functional.max_pool2d(-plane, 3, stride=1, padding=1)
    return torch.where(plane <= lowest_near, plane, torch.inf).reshape(-1, side * side).T


def _adam(batch: _Batch, settings: FitSettings) -> Tensor:
    """Batched Adam (B, 2) from the centroid of the points: the named alternative, a local method."""
    center = torch.zeros_like(batch.anchor_xz, requires_grad=True)
    optimiser = torch.optim.Adam([center], lr=settings.adam_learning_rate)
    for _ in range(settings.adam_steps):
        optimiser.zero_grad()
        batch.loss(center).total.sum().backward()
        optimiser.step()
    return center
