"""Optimisation-only fit: with size and heading frozen, find the (x, z) that minimises the balanced loss.

The loss has several minima per object (either side of the points, and jumps where rays begin to hit),
so one descent from one start does not do. It is cheap, so the default searches the whole plane around
the points: a coarse grid of cells, then a beam search that splits the best cells in four, level by level.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from boxlift.camera import Floats
from boxlift.frame import LossTerms
from boxlift.losses import BevBoxes, balanced_loss, point_density, point_losses
from boxlift.settings import FitSettings, LossSettings

# Beyond half the box's diagonal from the mean of its points a centre only gets worse; this is slack.
_SEARCH_MARGIN_M = 1.8
# The coarse grid is looked at through a third of the points; its best cells are then weighed by all.
_SCOUTS = 34
_SCOUTED_CELLS = 400
# The beam gets narrower with every level, down to a third: the finer, the less a cell hides.
_BEAM_NARROWS = 0.75
# Objects in one tensor expression. Searched, more would push the intermediate tensors out of the cache;
# Adam's are small, and a step of it takes hardly longer for many objects than for one.
_BATCH = {"search": 4, "adam": 256}
# A search over so few cells that its tensors are small takes more objects at once.
_SMALL_SEARCH_CELLS, _SMALL_SEARCH_BATCH = 400, 32
# Single precision holds 4 micrometres at 70 m.
_DTYPE = torch.float32


@dataclass(frozen=True)
class FitProblem:
    """One object with one hypothesis of its heading.

    points_xz: (M, 2) object-LiDAR-points, rectified camera frame. origin_xz: (2,) where the rays start, or
    (M, 2) where those of each point do; all problems of a call alike.
    start_xz: (2,) where the search begins; the mean of the points where none is given.
    """

    points_xz: Floats
    length_m: float
    width_m: float
    rotation_y: float
    origin_xz: Floats
    start_xz: Floats | None = None

    @property
    def anchor_xz(self) -> Floats:
        """(2,) the middle of the search."""
        anchor: Floats = self.points_xz.mean(axis=0) if self.start_xz is None else self.start_xz
        return anchor


@dataclass(frozen=True)
class FitSolution:
    """The centre (x, z) at the minimum, and the loss there."""

    center_xz: Floats
    losses: LossTerms


@dataclass(frozen=True)
class _Batch:
    """B problems as tensors: points (B, M, 2) padded to a common M, and their means as anchors (B, 2)."""

    points_xz: Tensor
    valid: Tensor
    density: Tensor
    anchor_xz: Tensor
    origin_xz: Tensor
    length: Tensor
    width: Tensor
    rotation_y: Tensor
    settings: LossSettings

    def thinned(self, count: int) -> _Batch:
        """The same problems seen through `count` of their points, evenly picked among the valid ones."""
        counts = self.valid.sum(-1, keepdim=True)
        index = torch.arange(count) * counts // count
        return replace(
            self,
            points_xz=self.points_xz.gather(1, index[..., None].expand(-1, -1, 2)),
            valid=self.valid.gather(1, index),
            density=self.density.gather(1, index),
            origin_xz=self.origin_xz
            if self.origin_xz.dim() == 2
            else self.origin_xz.gather(1, index[..., None].expand(-1, -1, 2)),
        )

    def boxes(self, center_xz: Tensor) -> BevBoxes:
        """Boxes at centres (..., B, 2), relative to the anchors."""
        return BevBoxes(center_xz + self.anchor_xz, self.length, self.width, self.rotation_y)

    def loss(self, center_xz: Tensor) -> Tensor:
        """Centres (..., B, 2), relative to the anchors -> the balanced loss (..., B)."""
        boxes = self.boxes(center_xz)
        return balanced_loss(self.points_xz, self.valid, boxes, self.origin_xz, self.settings, self.density)

    def solutions(self, center_xz: Tensor) -> list[FitSolution]:
        """The final centres (B, 2), relative to the anchors, with what the loss is made of there."""
        boxes = self.boxes(center_xz)
        means = point_losses(self.points_xz, boxes, self.origin_xz, self.settings).means(self.valid)
        columns = torch.stack([*means, self.loss(center_xz)], dim=-1).tolist()
        return [
            FitSolution(xz, LossTerms(*terms))
            for xz, terms in zip(boxes.center_xz.double().numpy(), columns, strict=True)
        ]


def fit_boxes(
    problems: Sequence[FitProblem], settings: FitSettings, loss: LossSettings, pad_to: int
) -> list[FitSolution]:
    """Fit all problems, in batches; the answer to one does not depend on the others.

    `pad_to` is the number of points that every problem is padded to (the sample count): a fixed shape
    keeps the order of summation, and so the last bit, the same in every batch.
    """
    minimise = _search if settings.method == "search" else _adam
    solutions: list[FitSolution] = []
    size = _BATCH[settings.method]
    if settings.method == "search" and (2 * settings.grid_steps + 1) ** 2 <= _SMALL_SEARCH_CELLS:
        size = _SMALL_SEARCH_BATCH
    for start in range(0, len(problems), size):
        with torch.set_grad_enabled(settings.method == "adam"):
            batch = _stack(problems[start : start + size], loss, pad_to)
            center = minimise(batch, settings).detach()
        with torch.no_grad():
            solutions += batch.solutions(center)
    return solutions


def _stack(problems: Sequence[FitProblem], loss: LossSettings, pad_to: int) -> _Batch:
    pad_to = max(pad_to, *(len(problem.points_xz) for problem in problems))
    points = np.zeros((len(problems), pad_to, 2))
    valid = np.zeros((len(problems), pad_to), dtype=np.bool_)
    for row, problem in enumerate(problems):
        count = len(problem.points_xz)
        points[row, :count] = problem.points_xz
        valid[row, :count] = True
    points_xz, is_valid = torch.from_numpy(points).to(_DTYPE), torch.from_numpy(valid)

    def column(name: str) -> Tensor:
        return torch.tensor(np.array([getattr(problem, name) for problem in problems]), dtype=_DTYPE)

    return _Batch(
        points_xz=points_xz,
        valid=is_valid,
        density=point_density(points_xz, is_valid, loss.density_radius_m),
        anchor_xz=torch.from_numpy(np.stack([problem.anchor_xz for problem in problems])).to(_DTYPE),
        origin_xz=_origins(problems, pad_to),
        length=column("length_m"),
        width=column("width_m"),
        rotation_y=column("rotation_y"),
        settings=loss,
    )


def _origins(problems: Sequence[FitProblem], pad_to: int) -> Tensor:
    """(B, 2), or (B, M, 2) padded as the points are."""
    origins = [problem.origin_xz for problem in problems]
    if origins[0].ndim == 2:
        origins = [np.pad(each, [(0, pad_to - len(each)), (0, 0)]) for each in origins]
    return torch.tensor(np.array(origins), dtype=_DTYPE)


def _search(batch: _Batch, settings: FitSettings) -> Tensor:
    """Global minimum (B, 2): all cells of a coarse grid, then the best ones split in four at each level.

    Many cells are kept, not only the local minima: where rays begin to miss the box the loss jumps, and
    the centre of a cell says little about what lies in its corner.
    """
    reach = torch.hypot(batch.length, batch.width) / 2 + _SEARCH_MARGIN_M
    if settings.reach_m is not None:
        reach = torch.full_like(reach, settings.reach_m)
    step = reach / settings.grid_steps
    side = torch.arange(-settings.grid_steps, settings.grid_steps + 1, dtype=_DTYPE)
    grid = torch.cartesian_prod(side, side)[:, None] * step[:, None]
    cells = grid
    if len(grid) > _SCOUTED_CELLS:
        cells, _ = _lowest(grid, batch.thinned(_SCOUTS).loss(grid), _SCOUTED_CELLS)
    total = batch.loss(cells)
    best, lowest = _lowest(cells, total, 1)
    quarters = torch.cartesian_prod(*[torch.tensor([-0.25, 0.25], dtype=_DTYPE)] * 2)[:, None, None]
    for level in range(settings.levels):
        width = round(settings.beam_width * max(_BEAM_NARROWS**level, 1 / 3))
        kept, _ = _lowest(cells, total, width)
        cells = (kept + quarters * step[:, None]).flatten(0, 1)
        total = batch.loss(cells)
        step = step / 2
        level_best, level_lowest = _lowest(cells, total, 1)
        improved = level_lowest < lowest
        best = torch.where(improved[..., None], level_best, best)
        lowest = torch.where(improved, level_lowest, lowest)
    return best[0]


def _lowest(cells: Tensor, total: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """The `count` cells (K, B, 2) of lowest loss (K, B) per object, and their loss; ties by position.

    A stable sort, as torch.topk breaks ties by memory layout, which depends on the batch.
    """
    ordered, index = total.sort(dim=0, stable=True)
    return cells.gather(0, index[:count, :, None].expand(-1, -1, 2)), ordered[:count]


def _adam(batch: _Batch, settings: FitSettings) -> Tensor:
    """Batched Adam (B, 2) from the centroid of the points: the named alternative, a local method."""
    center = torch.zeros_like(batch.anchor_xz, requires_grad=True)
    optimiser = torch.optim.Adam([center], lr=settings.adam_learning_rate)
    for _ in range(settings.adam_steps):
        (center.grad,) = torch.autograd.grad(batch.loss(center).sum(), [center])
        optimiser.step()
    return center
