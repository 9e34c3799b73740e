"""The ground: a curved road with camber and kerbs over a landscape with slope, crest and waves.

Scene frame: x forward, y left, z up, metres; the origin is the road under the camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boxlift.camera import Floats
from boxlift.datasets.generated.meshes import Material, Mesh, Surface

KERB_HEIGHT_M = 0.12
PAVEMENT_WIDTH_M = 2.6
_GROUND = Surface((0.2, 0.2, 0.2), 0.25, Material.GROUND)


@dataclass(frozen=True)
class Terrain:
    """Heights and road coordinates; made by `random_terrain`."""

    half_width_m: float  # of the road, parking lanes included
    lane_offset_m: float  # of the road's middle, left of the car
    bend_rad: float
    curvature_per_m: float
    slope: float
    crest_per_m: float
    wave_m: float
    wave_length_m: float
    wave_phase: float
    camber: float
    verge_slope: tuple[float, float]  # left, right of the pavements
    crossings_x_m: tuple[float, ...]  # where side roads cross

    def road_y(self, x: Floats) -> Floats:
        """y of the middle of the road."""
        return self.lane_offset_m + self.bend_rad * x + 0.5 * self.curvature_per_m * x * np.abs(x)

    def road_heading(self, x: float) -> float:
        """Direction of the road at x, radians left of forward."""
        return float(np.arctan(self.bend_rad + self.curvature_per_m * abs(x)))

    def across(self, x: Floats, y: Floats) -> Floats:
        """Distance left of the road's middle."""
        return np.asarray(y - self.road_y(x))

    def in_crossing(self, x: Floats) -> Floats:
        """1 on a side road, 0 elsewhere, with ramps of half a metre for the kerbs."""
        inside = np.zeros_like(x)
        for crossing in self.crossings_x_m:
            inside = np.maximum(inside, np.clip((4.5 - np.abs(x - crossing)) / 0.5, 0, 1))
        return inside

    def height(self, x: Floats, y: Floats) -> Floats:
        """Ground height at points of the plan view."""
        return self._raw_height(x, y) - self._raw_height(np.zeros(()), np.zeros(()))

    def _raw_height(self, x: Floats, y: Floats) -> Floats:
        across = self.across(x, y)
        away = np.abs(across)
        along = self.slope * x + 0.5 * self.crest_per_m * x**2 / (1 + np.abs(x) / 120)
        along = along + self.wave_m * np.sin(2 * np.pi * x / self.wave_length_m + self.wave_phase)
        kerb = KERB_HEIGHT_M * np.clip((away - self.half_width_m) / 0.02, 0, 1) * (1 - self.in_crossing(x))
        beyond = np.maximum(away - self.half_width_m - PAVEMENT_WIDTH_M, 0)
        verge = np.where(across > 0, self.verge_slope[0], self.verge_slope[1]) * np.minimum(beyond, 25)
        return np.asarray(along - self.camber * np.minimum(away, self.half_width_m) + kerb + verge)

    def mesh(self, reach_m: float = 150.0) -> Mesh:
        """The ground as a grid that follows the road, with a vertical step at the kerbs."""
        x = np.unique(
            np.concatenate(
                [np.linspace(-reach_m, reach_m, 201)]
                + [[at - 4.5, at - 4.0, at + 4.0, at + 4.5] for at in self.crossings_x_m]
            )
        )
        edge = self.half_width_m
        side = np.concatenate(
            [
                np.linspace(0, edge, 6),
                [edge + 0.02, edge + 1.3, edge + PAVEMENT_WIDTH_M],
                edge + PAVEMENT_WIDTH_M + np.array([1, 3, 6, 10, 15, 25, 60, reach_m]),
            ]
        )
        across = np.concatenate([-side[:0:-1], side])
        grid_x = np.repeat(x[:, None], len(across), axis=1)
        grid_y = self.road_y(grid_x) + across
        vertices = np.stack([grid_x, grid_y, self.height(grid_x, grid_y)], axis=-1).reshape(-1, 3)
        index = np.arange(len(vertices)).reshape(grid_x.shape)
        a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
        triangles = np.concatenate(
            [np.stack([a, b, c], axis=-1).reshape(-1, 3), np.stack([a, c, d], axis=-1).reshape(-1, 3)]
        )
        return Mesh(vertices, triangles, np.zeros(len(triangles), dtype=np.int64), (_GROUND,))


def random_terrain(
    rng: np.random.Generator, relief: float, half_width_m: float, crossings_x_m: tuple[float, ...]
) -> Terrain:
    """A terrain; `relief` 0 is flat, 1 an ordinary town, 2 hilly."""
    return Terrain(
        half_width_m=half_width_m,
        lane_offset_m=float(rng.uniform(1.5, 2.0)),
        bend_rad=float(rng.normal(0, 0.02)),
        curvature_per_m=float(rng.normal(0, 0.0015)),
        slope=float(relief * rng.normal(0, 0.008)),
        crest_per_m=float(relief * rng.normal(0, 0.0009)),
        wave_m=float(relief * rng.uniform(0, 0.12)),
        wave_length_m=float(rng.uniform(30, 70)),
        wave_phase=float(rng.uniform(0, 2 * np.pi)),
        camber=float(rng.uniform(0.005, 0.025)),
        verge_slope=(float(relief * rng.normal(0, 0.04)), float(relief * rng.normal(0, 0.04))),
        crossings_x_m=crossings_x_m,
    )
