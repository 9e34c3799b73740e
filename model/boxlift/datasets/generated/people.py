"""Pedestrians and cyclists of tubes and ellipsoids."""

from __future__ import annotations

import numpy as np

from boxlift.camera import Floats
from boxlift.datasets.generated.meshes import Color, Mesh, Surface, Vector, block, ellipsoid, joined, tube

_SKINS: tuple[Color, ...] = ((0.55, 0.36, 0.27), (0.42, 0.25, 0.17), (0.20, 0.11, 0.07))
_HAIRS: tuple[Color, ...] = ((0.03, 0.02, 0.015), (0.12, 0.07, 0.03), (0.30, 0.22, 0.10))
_CLOTHES: tuple[Color, ...] = (
    (0.02, 0.02, 0.03), (0.04, 0.06, 0.16), (0.45, 0.44, 0.42), (0.35, 0.03, 0.04), (0.08, 0.16, 0.07),
    (0.10, 0.10, 0.11), (0.30, 0.20, 0.10), (0.10, 0.22, 0.40), (0.55, 0.42, 0.05),
)  # fmt: skip
_RUBBER = Surface((0.02, 0.02, 0.02), 0.08)
_SHOE = Surface((0.03, 0.025, 0.02), 0.2)


def pedestrian(rng: np.random.Generator) -> Mesh:
    """A person standing or in mid-stride; one in eight is a child, some carry a backpack."""
    height = rng.uniform(1.10, 1.45) if rng.random() < 0.125 else rng.normal(1.73, 0.08)
    top, trousers, skin, hair = _outfit(rng)
    stride = rng.uniform(0.0, 0.42) if rng.random() < 0.8 else rng.uniform(0.0, 0.05)
    girth = rng.uniform(0.9, 1.2)
    parts = []
    for side, swing in ((1, stride), (-1, -stride)):
        hip, y = 0.51, 0.055 * side
        foot = np.array([0.5 * np.sin(swing), y, 0.035])
        knee = np.array([0.30 * np.sin(swing) + 0.03, y, 0.28])
        parts.append(tube([(0, y, hip), knee, foot], (0.055 * girth, 0.04, 0.028), trousers))
        parts.append(block(foot - _vector(0.045, 0.026, 0.035), foot + _vector(0.10, 0.026, 0.01), _SHOE))
        shoulder = np.array([0.0, 0.115 * girth * side, 0.81])
        elbow = shoulder + _vector(-0.17 * np.sin(0.8 * swing) - 0.01, 0.02 * side, -0.175)
        hand = elbow + _vector(-0.14 * np.sin(swing) + 0.05, -0.005 * side, -0.145)
        parts.append(tube([shoulder, elbow, hand], (0.034, 0.027, 0.02), top))
        parts.append(ellipsoid(hand, (0.022, 0.018, 0.03), skin, 4, 6))
    parts.append(_torso((0, 0, 0.47), (0.0, 0, 0.83), girth, top))
    parts += _head((0.01, 0, 0.925), skin, hair)
    if rng.random() < 0.25:
        parts.append(
            block((-0.17 * girth, -0.08, 0.58), (-0.06 * girth, 0.08, 0.80), Surface(_pick(rng, _CLOTHES)))
        )
    body = joined(parts)
    size = (body.upper - body.lower) * height / (body.upper - body.lower)[2]
    return body.fitted(tuple(size))


def cyclist(rng: np.random.Generator) -> Mesh:
    """A rider on a city or trekking bicycle; the box holds both."""
    top, trousers, skin, hair = _outfit(rng)
    paint = Surface(_pick(rng, _CLOTHES), 0.35)
    wheel, lean = rng.uniform(0.32, 0.36), rng.uniform(0.15, 0.42)
    base = rng.uniform(1.02, 1.12)
    rear, front = np.array([-base / 2, 0, wheel]), np.array([base / 2, 0, wheel])
    crank, saddle = np.array([-0.10, 0, 0.29]), np.array([-0.27, 0, 0.93])
    head_tube, grip_x, grip_z = np.array([0.36, 0, 0.88]), 0.38, rng.uniform(1.0, 1.12)
    parts = [_rim(rear, wheel), _rim(front, wheel)]
    frame = ((rear, crank), (rear, saddle), (crank, saddle), (crank, head_tube), (saddle, head_tube))
    parts += [tube(bar, 0.02, paint, 6) for bar in frame]
    parts.append(tube([head_tube, front], 0.018, paint, 6))
    parts.append(tube([head_tube, (grip_x, 0, grip_z)], 0.016, _RUBBER, 6))
    parts.append(tube([(grip_x, -0.29, grip_z), (grip_x, 0.29, grip_z)], 0.016, _RUBBER, 6))
    parts.append(block(saddle - _vector(0.12, 0.07, 0.02), saddle + _vector(0.12, 0.07, 0.05), _RUBBER))
    hip = saddle + _vector(0.02, 0, 0.08)
    shoulder = hip + 0.55 * np.array([np.sin(lean), 0, np.cos(lean)])
    phase = rng.uniform(0, np.pi)
    for side in (-1, 1):
        angle = phase + (np.pi if side > 0 else 0)
        pedal = crank + _vector(0.16 * np.cos(angle), 0.11 * side, 0.16 * np.sin(angle))
        hip_side = hip + _vector(0, 0.09 * side, 0)
        knee = (hip_side + pedal) / 2 + _vector(0.27, 0.02 * side, 0.10)
        parts.append(tube([hip_side, knee, pedal], (0.085, 0.06, 0.045), trousers))
        parts.append(block(pedal - _vector(0.08, 0.045, 0.05), pedal + _vector(0.17, 0.045, 0.02), _SHOE))
        grip = np.array([grip_x, 0.25 * side, grip_z])
        arm = shoulder + _vector(0, 0.19 * side, -0.04)
        elbow = (arm + grip) / 2 + _vector(-0.04, 0.05 * side, -0.07)
        parts.append(tube([arm, elbow, grip], (0.055, 0.045, 0.035), top))
    parts.append(_torso(hip - _vector(0, 0, 0.04), shoulder + _vector(0, 0, 0.02), 1.75, top))
    parts += [
        part.moved(shoulder + _vector(0.09, 0, 0.19)) for part in _head((0, 0, 0), skin, hair, scale=1.72)
    ]
    return joined(parts)


def _outfit(rng: np.random.Generator) -> tuple[Surface, Surface, Surface, Surface]:
    top = Surface(_pick(rng, _CLOTHES), rng.uniform(0.15, 0.6))
    trousers = Surface(_pick(rng, _CLOTHES[:6]), rng.uniform(0.15, 0.5))
    return top, trousers, Surface(_pick(rng, _SKINS), 0.4), Surface(_pick(rng, _HAIRS), 0.15)


def _vector(x: float, y: float, z: float) -> Floats:
    return np.array([x, y, z])


def _pick(rng: np.random.Generator, colors: tuple[Color, ...]) -> Color:
    return colors[rng.integers(len(colors))]


def _torso(hip: Vector, shoulder: Vector, girth: float, surface: Surface) -> Mesh:
    """From hip to shoulder, wider than deep; `girth` 1 is a body of height 1."""
    low, high = np.asarray(hip, dtype=np.float64), np.asarray(shoulder, dtype=np.float64)
    path = low + np.array([0, 0.15, 0.4, 0.75, 0.93, 1.0])[:, None] * (high - low)
    return tube(path, girth * np.array([0.08, 0.095, 0.09, 0.11, 0.10, 0.05]), surface, 10, flatten=0.65)


def _head(center: tuple[float, float, float], skin: Surface, hair: Surface, scale: float = 1.0) -> list[Mesh]:
    middle = np.asarray(center)
    return [
        tube([middle - np.array([0.01, 0, 0.11]) * scale, middle], 0.032 * scale, skin),
        ellipsoid(middle, np.array([0.055, 0.045, 0.07]) * scale, skin),
        ellipsoid(middle + np.array([-0.012, 0, 0.018]) * scale, np.array([0.055, 0.05, 0.06]) * scale, hair),
    ]


def _rim(center: Floats, radius: float) -> Mesh:
    """A bicycle wheel: a ring with a few spokes."""
    angle = np.linspace(0, 2 * np.pi, 17)
    ring = center + (radius - 0.02) * np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=-1)
    spokes = [
        tube([center - (ring[i] - center) * 0.95, center + (ring[i] - center) * 0.95], 0.005, _RUBBER, 3)
        for i in (0, 2, 4, 6)
    ]
    return joined([tube(ring, 0.02, _RUBBER, 6), *spokes])
