"""What stands about: buildings, walls, poles, trees, hedges and bushes. Scene frame, standing at z = 0."""

from __future__ import annotations

import numpy as np

from boxlift.datasets.generated.meshes import (
    Color,
    Material,
    Mesh,
    Surface,
    block,
    ellipsoid,
    joined,
    loft,
    tube,
)

_FACADES: tuple[Color, ...] = (
    (0.55, 0.47, 0.35), (0.60, 0.56, 0.48), (0.38, 0.20, 0.14), (0.50, 0.50, 0.50), (0.62, 0.50, 0.28),
)  # fmt: skip
_STONE = Surface((0.32, 0.30, 0.27), 0.35)
_METAL = Surface((0.22, 0.23, 0.24), 0.35)
_SIGN = Surface((0.65, 0.10, 0.08), 1.0)
_BARK = Surface((0.09, 0.07, 0.05), 0.3)


def building(rng: np.random.Generator, length_m: float, depth_m: float) -> Mesh:
    """A house of `length_m` along x and `depth_m` along y, sunk 1 m, with a hipped or flat roof."""
    color = _FACADES[rng.integers(len(_FACADES))]
    facade = Surface(color, rng.uniform(0.25, 0.5), Material.FACADE)
    height = rng.uniform(5.0, 11.0)
    x, y = length_m / 2, depth_m / 2
    parts = [block((-x, -y, -1.5), (x, y, height), facade)]
    if rng.random() < 0.7:
        roof = Surface((0.22, 0.08, 0.05) if rng.random() < 0.6 else (0.08, 0.08, 0.09), 0.25)
        ridge = height + min(depth_m * rng.uniform(0.25, 0.45), 5.0)
        eaves = np.array([[-x, -y - 0.4, height], [-x, 0, ridge], [-x, y + 0.4, height]])
        vertices = np.concatenate([eaves, eaves * (-1, 1, 1)])
        triangles = np.array(
            [[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [0, 2, 1], [3, 4, 5], [0, 3, 5], [0, 5, 2]]
        )
        parts.append(Mesh(vertices, triangles, np.zeros(len(triangles), dtype=np.int64), (roof,)))
    return joined(parts)


def wall(length_m: float, height_m: float) -> Mesh:
    """A garden wall along x."""
    return block((-length_m / 2, -0.12, -1.0), (length_m / 2, 0.12, height_m), _STONE)


def pole(rng: np.random.Generator) -> Mesh:
    """A lamp, a traffic sign or a bollard."""
    kind = rng.random()
    if kind < 0.45:
        height = rng.uniform(5, 8)
        arm = [(0, 0, -0.5), (0, 0, height - 0.5), (0, 0.3, height), (0, 1.2, height + 0.1)]
        return tube(arm, (0.09, 0.07, 0.06, 0.05), _METAL)
    if kind < 0.85:
        height = rng.uniform(2.2, 2.8)
        plate = block((-0.02, -0.3, height - 0.6), (0.0, 0.3, height), _SIGN)
        return joined([tube([(0.03, 0, -0.5), (0.03, 0, height)], 0.035, _METAL), plate])
    return tube([(0, 0, -0.3), (0, 0, 1.0)], 0.08, _STONE)


def tree(rng: np.random.Generator) -> Mesh:
    """A trunk with a crown of three or four leafy clumps."""
    height, radius = rng.uniform(2.2, 3.2), rng.uniform(0.12, 0.25)
    parts = [tube([(0, 0, -0.5), (0, 0, height + 1)], (1.2 * radius, 0.8 * radius), _BARK)]
    leaves = _leaves(rng)
    for _ in range(rng.integers(3, 5)):
        spread = rng.uniform(0.9, 1.9)
        center = (*rng.uniform(-0.9, 0.9, 2), height + rng.uniform(0.8, 2.6))
        parts.append(_clump(rng, center, (spread, spread, 0.8 * spread), leaves))
    return joined(parts)


def bush(rng: np.random.Generator) -> Mesh:
    """A bush of the height of a car or less."""
    width, height = rng.uniform(0.5, 1.3), rng.uniform(0.4, 0.9)
    return _clump(rng, (0, 0, 0.8 * height), (width, width * rng.uniform(0.6, 1.2), height), _leaves(rng))


def hedge(rng: np.random.Generator, length_m: float) -> Mesh:
    """A clipped hedge along x with an uneven face."""
    height, half = rng.uniform(0.9, 2.0), rng.uniform(0.3, 0.5)
    stations = max(int(length_m / 0.5), 3)
    x = np.linspace(-length_m / 2, length_m / 2, stations)
    outline = np.array(
        [[-half, -0.5], [half, -0.5], [half, 0.9 * height], [0, height], [-half, 0.9 * height]]
    )
    rings = np.concatenate(
        [np.repeat(x[:, None, None], len(outline), axis=1), np.repeat(outline[None], stations, axis=0)],
        axis=2,
    )
    rings[:, 1:, :] += rng.normal(0, 0.06, rings[:, 1:, :].shape)
    return loft(rings, (_leaves(rng),))


def _leaves(rng: np.random.Generator) -> Surface:
    green = rng.uniform(0.05, 0.12)
    color = (green * rng.uniform(0.5, 0.9), green, green * rng.uniform(0.2, 0.4))
    return Surface(color, rng.uniform(0.35, 0.55), Material.FOLIAGE)


def _clump(
    rng: np.random.Generator,
    center: tuple[float, ...],
    radii_m: tuple[float, float, float],
    leaves: Surface,
) -> Mesh:
    stacks, sides = 9, 14
    dents = 1 + rng.normal(0, 0.09, (stacks + 1, sides))
    return ellipsoid(center, radii_m, leaves, stacks, sides, dents)
