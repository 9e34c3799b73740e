"""The ground as a surface: roads slope, crest and have kerbs, so one plane does not do.

The lowest point of each cell is ground where no cell around it lies much lower (a cone filter after
Vosselman, "Slope based filtering of laser altimetry data", 2000); local planes through those cells make
the surface. All heights are above a plane that was fitted before: what remains is small.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Floats
from boxlift.settings import GroundSettings

# The grid covers this far to each side of the camera and ahead, and a little behind it, metres.
_SIDE_M, _BEHIND_M, _AHEAD_M = 60.0, 4.0, 88.0
# A lowest point this far above its neighbours' cone is still ground; this far off a local plane it is not.
_CONE_SLACK_M = 0.1
_PLANE_SLACK_M = 0.15
# What rises higher than this within a cell is not only ground.
_FLAT_M = 0.4
_CONE_REACH_CELLS = 4
# A point may lie this far off the first plane, and this much more per metre of range, to be ground at all.
_OFF_PLANE_M, _OFF_PLANE_PER_M = 0.6, 0.06
# Windows (in cells to each side) of the local planes: the smallest that holds enough ground cells.
_WINDOWS = (1, 2, 4, 8)
_ENOUGH_CELLS = 8
# Pulls the slope of a local plane to that of the first one where few cells say otherwise.
_RIDGE = 4.0
_ROUNDS = 2


@dataclass(frozen=True)
class GroundSurface:
    """Height of the ground above a plane, on a grid over x and z of the rectified camera frame.

    height_m: (X, Z) at cell centres. known: (X, Z) whether ground was seen in or next to the cell.
    """

    height_m: Floats
    known: NDArray[np.bool_]
    cell_m: float

    def height_at(self, x: Floats, z: Floats) -> Floats:
        """(N,) and (N,) -> (N,) heights above the plane, bilinear; constant beyond the grid."""
        i, j = self._position(x, z)
        i, j = i.clip(0, self.height_m.shape[0] - 1.001), j.clip(0, self.height_m.shape[1] - 1.001)
        column, row = i.astype(np.intp), j.astype(np.intp)
        along_x, along_z = i - column, j - row
        height = self.height_m
        near = height[column, row] * (1 - along_x) + height[column + 1, row] * along_x
        far = height[column, row + 1] * (1 - along_x) + height[column + 1, row + 1] * along_x
        interpolated: Floats = near * (1 - along_z) + far * along_z
        return interpolated

    def is_known(self, x: Floats, z: Floats) -> NDArray[np.bool_]:
        """(N,) whether ground was seen around x, z."""
        i, j = self._position(x, z)
        columns, rows = self.known.shape
        inside = (i > -0.5) & (j > -0.5) & (i < columns - 0.5) & (j < rows - 0.5)
        column = np.rint(i).astype(np.intp).clip(0, columns - 1)
        row = np.rint(j).astype(np.intp).clip(0, rows - 1)
        known: NDArray[np.bool_] = self.known[column, row] & inside
        return known

    def _position(self, x: Floats, z: Floats) -> tuple[Floats, Floats]:
        return (x + _SIDE_M) / self.cell_m - 0.5, (z + _BEHIND_M) / self.cell_m - 0.5


def fit_surface(points_cam: Floats, above_plane_m: Floats, settings: GroundSettings) -> GroundSurface:
    """The ground under (N, 3) points whose heights (N,) above a first plane are given."""
    cell = settings.cell_m
    shape = (round(2 * _SIDE_M / cell), round((_BEHIND_M + _AHEAD_M) / cell))
    lowest, highest = _heights_per_cell(points_cam, above_plane_m, cell, shape)
    seen = np.isfinite(lowest)
    low = np.where(seen, lowest, 0.0)
    # Where beams are far apart the lowest point of a cell may be on a body: those reach up.
    is_ground = (
        seen
        & (highest - lowest < _FLAT_M)
        & (lowest <= _cone(lowest, settings.max_slope * cell) + _CONE_SLACK_M)
    )
    surface = np.zeros(shape)
    for _ in range(_ROUNDS):
        surface = _local_planes(low, is_ground)
        is_ground = seen & (np.abs(low - surface) < _PLANE_SLACK_M)
    return GroundSurface(surface, _window_sums(is_ground[None].astype(np.float64), 1)[0] > 0, cell)


def _heights_per_cell(
    points_cam: Floats, above_m: Floats, cell: float, shape: tuple[int, int]
) -> tuple[Floats, Floats]:
    """(X, Z) the lowest and the highest height in each cell, infinite where there is none."""
    x, z = points_cam[:, 0], points_cam[:, 2]
    reach = _OFF_PLANE_M + _OFF_PLANE_PER_M * np.hypot(x, z)
    near = (np.abs(x) < _SIDE_M) & (z > -_BEHIND_M) & (z < _AHEAD_M) & (np.abs(above_m) < reach)
    column = ((x[near] + _SIDE_M) / cell).astype(np.intp).clip(0, shape[0] - 1)
    row = ((z[near] + _BEHIND_M) / cell).astype(np.intp).clip(0, shape[1] - 1)
    index, heights = column * shape[1] + row, above_m[near]
    lowest, highest = np.full(shape[0] * shape[1], np.inf), np.full(shape[0] * shape[1], -np.inf)
    np.minimum.at(lowest, index, heights)
    np.maximum.at(highest, index, heights)
    return lowest.reshape(shape), highest.reshape(shape)


def _cone(lowest: Floats, rise_per_cell: float) -> Floats:
    """(X, Z) the height that a cell's neighbours allow it: theirs plus the largest slope."""
    allowed = lowest.copy()
    reach = _CONE_REACH_CELLS
    padded = np.pad(lowest, reach, constant_values=np.inf)
    columns, rows = lowest.shape
    for i in range(2 * reach + 1):
        for j in range(2 * reach + 1):
            distance = np.hypot(i - reach, j - reach)
            if 0 < distance <= reach:
                neighbour = padded[i : i + columns, j : j + rows]
                np.minimum(allowed, neighbour + rise_per_cell * distance, out=allowed)
    return allowed


def _local_planes(low: Floats, is_ground: NDArray[np.bool_]) -> Floats:
    """(X, Z) heights at the cells, each from a plane through the ground cells around it; 0 without any."""
    weight = is_ground.astype(np.float64)
    x, z = (axis - axis.mean() for axis in np.indices(low.shape, dtype=np.float64))
    y = low * weight
    moments = np.stack(
        [weight, x * weight, z * weight, y, x * x * weight, x * z * weight, z * z * weight, x * y, z * y]
    )
    surface = np.full(low.shape, np.nan)
    sums_over = _running_sums(moments, _WINDOWS[-1])
    for window in _WINDOWS:
        missing = np.isnan(surface)
        if not missing.any():
            break
        sums = sums_over(window)
        needed = min(_ENOUGH_CELLS, 0.3 * (2 * window + 1) ** 2) if window < _WINDOWS[-1] else 1
        here = missing & (sums[0] >= needed)
        n, sx, sz, sy, sxx, sxz, szz, sxy, szy = sums[:, here]
        mean_x, mean_z, mean_y = sx / n, sz / n, sy / n
        xx, zz = sxx - n * mean_x**2 + n * _RIDGE, szz - n * mean_z**2 + n * _RIDGE
        xz, xy, zy = sxz - n * mean_x * mean_z, sxy - n * mean_x * mean_y, szy - n * mean_z * mean_y
        determinant = xx * zz - xz**2
        slope_x, slope_z = (xy * zz - xz * zy) / determinant, (xx * zy - xz * xy) / determinant
        surface[here] = mean_y + slope_x * (x[here] - mean_x) + slope_z * (z[here] - mean_z)
    filled: Floats = np.nan_to_num(surface)
    return filled


def _window_sums(layers: Floats, reach: int) -> Floats:
    """(L, X, Z) -> (L, X, Z) sums over the square of `reach` cells to each side."""
    return _running_sums(layers, reach)(reach)


def _running_sums(layers: Floats, most: int) -> Callable[[int], Floats]:
    """Sums of (L, X, Z) over squares of up to `most` cells to each side, from one table of running sums."""
    margin = ((0, 0), (most + 1, most), (most + 1, most))
    table = np.pad(layers, margin).cumsum(axis=1).cumsum(axis=2)
    columns, rows = layers.shape[1:]

    def sums(reach: int) -> Floats:
        low, high = most - reach, most + reach + 1
        left, right = slice(low, low + columns), slice(high, high + columns)
        near, far = slice(low, low + rows), slice(high, high + rows)
        total: Floats = (
            table[:, right, far] - table[:, left, far] - table[:, right, near] + table[:, left, near]
        )
        return total

    return sums
