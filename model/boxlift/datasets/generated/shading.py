"""Colours for the camera's rays: Lambert under sun and sky, shadows, glossy paint, painted roads."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Floats
from boxlift.datasets.generated.meshes import Material
from boxlift.datasets.generated.scene import Scene
from boxlift.datasets.generated.sensors import Hits, RayCaster
from boxlift.datasets.generated.terrain import PAVEMENT_WIDTH_M

_SUN_RGB = np.array([1.9, 1.75, 1.5])
_ZENITH_RGB = np.array([0.22, 0.38, 0.70])
_HORIZON_RGB = np.array([0.68, 0.76, 0.84])
_CLOUD_RGB = np.array([0.72, 0.74, 0.77])
_HAZE_RANGE_M = 420.0


def picture(
    caster: RayCaster, scene: Scene, origin: Floats, directions: Floats, hits: Hits, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """(H, W, 3) RGB of hits (H, W) along unit directions (H, W, 3)."""
    color = sky(directions, scene)
    met = hits.face >= 0
    ray, face, range_m = directions[met], hits.face[met], hits.range_m[met]
    normal = hits.normal[met]
    normal = normal * -np.sign((normal * ray).sum(axis=1, keepdims=True))
    points = origin + ray * range_m[:, None]
    material = caster.material[face]

    albedo = caster.rgb[face].copy()
    ground, facade = material == Material.GROUND, material == Material.FACADE
    albedo[ground] = _ground_rgb(scene, points[ground], range_m[ground])
    albedo[facade] = _facade_rgb(albedo[facade], points[facade], normal[facade])
    foliage = material == Material.FOLIAGE
    albedo[foliage] *= 0.5 + _speckle(points[foliage], 0.12)[:, None]

    lit = np.maximum(normal @ scene.sun, 0) * (1 - scene.overcast)
    facing = lit > 0
    lit[facing] *= ~caster.shadowed(points[facing] + 0.02 * normal[facing], scene.sun)
    ambient = (0.55 + 0.30 * normal[:, 2:]) * (0.55 * _ZENITH_RGB + 0.45 * _CLOUD_RGB + 0.25 * scene.overcast)
    shaded = albedo * (lit[:, None] * _SUN_RGB + ambient)

    mirror = ray - 2 * (ray * normal).sum(axis=1, keepdims=True) * normal
    fresnel = 0.04 + 0.96 * (1 - np.abs((ray * normal).sum(axis=1))) ** 5  # Schlick
    gloss = np.where(material == Material.GLASS, 1.6, np.where(material == Material.GLOSSY, 0.9, 0.0))
    below = np.array([0.16, 0.16, 0.16])
    mirrored = np.where(mirror[:, 2:] > 0, sky(mirror, scene), below)
    shaded = shaded + (gloss * fresnel)[:, None] * mirrored

    haze = (1 - np.exp(-range_m / _HAZE_RANGE_M))[:, None]
    color[met] = shaded * (1 - haze) + _HORIZON_RGB * haze
    color = _blurred(color)
    encoded = 255 * np.clip(color, 0, 1) ** (1 / 2.2) + rng.normal(0, 1.5, color.shape[:2])[..., None]
    return np.asarray(encoded.round().clip(0, 255).astype(np.uint8))


def sky(directions: Floats, scene: Scene) -> Floats:
    """(..., 3) colour of the sky along unit directions."""
    up = np.clip(directions[..., 2:], 0, 1) ** 0.5
    clear = _HORIZON_RGB * (1 - up) + _ZENITH_RGB * up
    return np.asarray(clear * (1 - scene.overcast) + _CLOUD_RGB * scene.overcast)


def _ground_rgb(scene: Scene, points: Floats, range_m: Floats) -> Floats:
    terrain = scene.terrain
    x, across = points[:, 0], terrain.across(points[:, 0], points[:, 1])
    away, edge = np.abs(across), terrain.half_width_m
    side_road = terrain.in_crossing(x) > 0.5
    grain = (_speckle(points, 0.05) - 0.5) * np.exp(-range_m / 15) + (_speckle(points, 1.7) - 0.5) * 0.4
    rgb = np.full((len(points), 3), 0.13)
    rgb[away > edge] = (0.27, 0.26, 0.25)
    rgb[(away > edge) & (away < edge + 0.15)] = (0.40, 0.40, 0.39)
    grass = away > edge + PAVEMENT_WIDTH_M
    rgb[grass] = (0.10, 0.15, 0.04)
    rgb[side_road] = 0.13
    dashes = (away < 0.07) & (x % 9.0 < 4.5)
    parking_line = (np.abs(away - (edge - 2.1)) < 0.05) & (edge > 5)
    rgb[(dashes | parking_line) & ~side_road] = (0.62, 0.62, 0.60)
    return np.asarray(rgb * (1 + 0.35 * grain[:, None]))


def _facade_rgb(wall: Floats, points: Floats, normal: Floats) -> Floats:
    """Rows of windows, 2.6 m apart and one storey of 3 m each."""
    along = points[:, 0] * -normal[:, 1] + points[:, 1] * normal[:, 0]
    column, storey = along / 2.6, points[:, 2] / 3.0
    window = (
        (np.abs(column % 1 - 0.5) < 0.23) & (np.abs(storey % 1 - 0.55) < 0.24) & (np.abs(normal[:, 2]) < 0.1)
    )
    return np.where(window[:, None], np.array([0.05, 0.06, 0.08]), wall)


def _speckle(points: Floats, cell_m: float) -> Floats:
    """Repeatable noise in 0..1, constant on cubes of a size (integer hash)."""
    cell = (np.floor(points / cell_m).astype(np.int64) + (1 << 20)).astype(np.uint64)
    mixed = cell[:, 0] * np.uint64(0x9E3779B1) + cell[:, 1] * np.uint64(0x85EBCA77) + cell[:, 2]
    # The finaliser of SplitMix64 (Steele, Lea and Flood, OOPSLA 2014).
    mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray((mixed >> np.uint64(40)) / float(1 << 24))


def _blurred(image: Floats) -> Floats:
    """A lens that is a little soft: 1-6-1 in both directions, which also calms the edges."""
    for axis in (0, 1):
        padded = np.pad(image, [(1, 1) if a == axis else (0, 0) for a in range(3)], mode="edge")
        ends = [np.take(padded, np.arange(image.shape[axis]) + shift, axis=axis) for shift in (0, 2)]
        image = 0.75 * image + 0.125 * (ends[0] + ends[1])
    return image
