"""Triangle meshes with a surface per face, and the few shapes that everything is built of.

Every body has its own frame: x forward, y left, z up, metres.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Floats

Color = tuple[float, float, float]
Vector = Sequence[float] | Floats


class Material(IntEnum):
    """What a ray meets, as far as sensors care."""

    SOLID = 0
    GLOSSY = 1  # car paint: mirrors a little sky
    GLASS = 2  # a LiDAR beam mostly passes or is lost
    FOLIAGE = 3  # a LiDAR beam returns from somewhere inside
    GROUND = 4  # coloured by position
    FACADE = 5  # windows by position


@dataclass(frozen=True)
class Surface:
    """Colour (linear RGB in 0..1), LiDAR reflectance (0..1) and material of a face."""

    rgb: Color
    reflectance: float = 0.3
    material: Material = Material.SOLID


@dataclass(frozen=True)
class Mesh:
    """vertices (V, 3), triangles (F, 3), and per face the index into `surfaces`."""

    vertices: Floats
    triangles: NDArray[np.int64]
    face_surface: NDArray[np.int64]
    surfaces: tuple[Surface, ...]

    @property
    def lower(self) -> Floats:
        """(3,) lower corner of the bounding box."""
        return np.asarray(self.vertices.min(axis=0))

    @property
    def upper(self) -> Floats:
        """(3,) upper corner of the bounding box."""
        return np.asarray(self.vertices.max(axis=0))

    def moved(self, offset: Vector) -> Mesh:
        """The mesh shifted by (3,)."""
        return replace(self, vertices=self.vertices + np.asarray(offset))

    def turned(self, heading_rad: float) -> Mesh:
        """The mesh turned about z."""
        cos, sin = np.cos(heading_rad), np.sin(heading_rad)
        return replace(self, vertices=self.vertices @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]))

    def fitted(self, size_lwh_m: Vector) -> Mesh:
        """The mesh scaled and shifted to fill exactly -l/2..l/2, -w/2..w/2, 0..h."""
        size = np.asarray(size_lwh_m, dtype=np.float64)
        unit = (self.vertices - self.lower) / (self.upper - self.lower)
        return replace(self, vertices=unit * size - np.array([size[0] / 2, size[1] / 2, 0.0]))


def joined(parts: Iterable[Mesh]) -> Mesh:
    """Several meshes as one."""
    pieces = list(parts)
    vertex_start = np.cumsum([0] + [len(part.vertices) for part in pieces])
    surface_start = np.cumsum([0] + [len(part.surfaces) for part in pieces])
    return Mesh(
        np.concatenate([part.vertices for part in pieces]),
        np.concatenate([part.triangles + at for part, at in zip(pieces, vertex_start, strict=False)]),
        np.concatenate([part.face_surface + at for part, at in zip(pieces, surface_start, strict=False)]),
        tuple(surface for part in pieces for surface in part.surfaces),
    )


def loft(
    rings: Floats,
    surfaces: Sequence[Surface],
    panel_surface: NDArray[np.int64] | int = 0,
    caps: tuple[int, int] | None = (0, 0),
) -> Mesh:
    """A skin over closed rings (S, R, 3); panel_surface (S - 1, R) picks a surface per quad.

    `caps` are the surfaces of the first and the last ring's lid, None leaves the ends open.
    """
    stations, around = rings.shape[:2]
    index = np.arange(stations * around).reshape(stations, around)
    here, there = index[:-1], index[1:]
    quads = np.stack([here, np.roll(here, -1, 1), np.roll(there, -1, 1), there], axis=-1).reshape(-1, 4)
    triangles = [quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]
    per_quad = np.broadcast_to(panel_surface, (stations - 1, around)).reshape(-1)
    face_surface = [per_quad, per_quad]
    vertices = rings.reshape(-1, 3)
    if caps is not None:
        middles = rings[[0, -1]].mean(axis=1)
        for end, (ring, surface) in enumerate(zip((index[0], index[-1]), caps, strict=True)):
            middle = np.full(around, len(vertices) + end)
            triangles.append(np.stack([middle, np.roll(ring, -1), ring], axis=-1))
            face_surface.append(np.full(around, surface))
        vertices = np.concatenate([vertices, middles])
    return Mesh(vertices, np.concatenate(triangles), np.concatenate(face_surface), tuple(surfaces))


def block(lower: Vector, upper: Vector, surface: Surface) -> Mesh:
    """A cuboid between two corners."""
    (x1, y1, z1), (x2, y2, z2) = lower, upper
    rings = np.array([[[x, y1, z1], [x, y2, z1], [x, y2, z2], [x, y1, z2]] for x in (x1, x2)])
    return loft(rings, (surface,))


def tube(
    path: Sequence[Vector] | Floats,
    radii_m: Vector | float,
    surface: Surface,
    sides: int = 8,
    flatten: float = 1.0,
) -> Mesh:
    """A round bar along a path of points, a radius at each; `flatten` scales it along its first normal."""
    points = np.asarray(path, dtype=np.float64)
    radius = np.broadcast_to(np.asarray(radii_m, dtype=np.float64), (len(points),))
    direction = np.gradient(points, axis=0)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    steep = np.abs(direction[:, 2:]) > 0.7
    first = np.cross(np.where(steep, [[0.0, 1.0, 0.0]], [[0.0, 0.0, 1.0]]), direction)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(direction, first)
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)[None, :, None]
    offsets = flatten * np.cos(angle) * first[:, None] + np.sin(angle) * second[:, None]
    return loft(points[:, None] + radius[:, None, None] * offsets, (surface,))


def ellipsoid(
    center: Vector,
    radii_m: Vector,
    surface: Surface,
    stacks: int = 6,
    sides: int = 8,
    dents: Floats | None = None,
) -> Mesh:
    """An ellipsoid; `dents` (stacks + 1, sides) scale the radius, which makes a bush of it."""
    polar = np.linspace(0.06, np.pi - 0.06, stacks + 1)[:, None]
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)[None, :]
    unit = np.stack(
        [np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), -np.cos(polar) + 0 * angle], axis=-1
    )
    if dents is not None:
        unit = unit * dents[..., None]
    return loft(unit * np.asarray(radii_m) + np.asarray(center), (surface,))


def disc(center: Vector, radius_m: float, thickness_m: float, surface: Surface, sides: int = 16) -> Mesh:
    """A flat cylinder whose axis is y: a wheel."""
    x, y, z = center
    half = thickness_m / 2
    return tube([[x, y - half, z], [x, y + half, z]], radius_m, surface, sides)
