"""Cars, vans and box trucks as lofts of a side profile, with wheels, glass and lights.

Door mirrors are left out: annotated boxes do not include them, and the truth is the tight box of a mesh.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Floats
from boxlift.datasets.generated.meshes import Color, Material, Mesh, Surface, block, disc, joined, loft

_GLASS = Surface((0.03, 0.035, 0.04), 0.15, Material.GLASS)
_TYRE = Surface((0.02, 0.02, 0.02), 0.06)
_RIM = Surface((0.45, 0.45, 0.47), 0.4)
_TRIM = Surface((0.03, 0.03, 0.03), 0.08)
_SEAT = Surface((0.05, 0.05, 0.055), 0.15)
_HEADLIGHT = Surface((0.75, 0.78, 0.8), 0.5, Material.GLOSSY)
_TAILLIGHT = Surface((0.5, 0.02, 0.02), 0.8, Material.GLOSSY)
_PLATE = Surface((0.8, 0.8, 0.78), 1.0)

# Linear colour, LiDAR reflectance (905 nm; black paint absorbs most) and share of the cars.
_PAINTS: tuple[tuple[Color, float, float], ...] = (
    ((0.42, 0.43, 0.45), 0.45, 0.26),  # silver
    ((0.012, 0.012, 0.014), 0.07, 0.24),  # black
    ((0.75, 0.75, 0.74), 0.65, 0.14),  # white
    ((0.10, 0.105, 0.11), 0.20, 0.12),  # grey
    ((0.02, 0.05, 0.18), 0.22, 0.11),  # blue
    ((0.32, 0.015, 0.02), 0.40, 0.09),  # red
    ((0.02, 0.08, 0.05), 0.20, 0.04),  # green
)

Range = tuple[float, float]


@dataclass(frozen=True)
class BodyStyle:
    """Side profile (share of length from the front, share of height) and the range of sizes in metres.

    windscreen, rear_window: shares of length that are glazed on top; belt: share of height at which
    the side windows begin; glazed: shares of length with side windows; pillars: where they are broken.
    """

    category: str
    share: float
    length_m: Range
    width_m: Range
    height_m: Range
    profile: tuple[tuple[float, float], ...]
    windscreen: Range
    rear_window: Range
    belt: float
    glazed: Range
    pillars: tuple[float, ...]
    wheel_radius_m: float = 0.31


_HATCHBACK = BodyStyle(
    "Car", 0.42, (3.55, 4.25), (1.60, 1.78), (1.42, 1.56),
    ((0, 0.40), (0.015, 0.47), (0.08, 0.56), (0.25, 0.645), (0.44, 0.955), (0.55, 1.0), (0.75, 0.985),
     (0.885, 0.93), (0.975, 0.64), (0.992, 0.56), (1, 0.40)),
    (0.25, 0.44), (0.885, 0.975), 0.64, (0.31, 0.90), (0.55, 0.76),
)  # fmt: skip
_SALOON = BodyStyle(
    "Car", 0.27, (4.30, 4.85), (1.70, 1.85), (1.40, 1.49),
    ((0, 0.42), (0.012, 0.49), (0.07, 0.57), (0.27, 0.66), (0.43, 0.965), (0.52, 1.0), (0.64, 0.98),
     (0.70, 0.945), (0.845, 0.71), (0.965, 0.69), (0.99, 0.60), (1, 0.42)),
    (0.27, 0.43), (0.70, 0.845), 0.66, (0.32, 0.80), (0.53, 0.70),
)  # fmt: skip
_ESTATE = BodyStyle(
    "Car", 0.20, (4.35, 4.80), (1.70, 1.83), (1.42, 1.53),
    ((0, 0.42), (0.012, 0.49), (0.07, 0.57), (0.26, 0.65), (0.41, 0.96), (0.50, 1.0), (0.80, 0.98),
     (0.93, 0.92), (0.985, 0.65), (0.994, 0.55), (1, 0.42)),
    (0.26, 0.41), (0.93, 0.985), 0.65, (0.30, 0.93), (0.50, 0.71),
)  # fmt: skip
_OFF_ROADER = BodyStyle(
    "Car", 0.11, (4.15, 4.70), (1.78, 1.92), (1.62, 1.76),
    ((0, 0.42), (0.012, 0.52), (0.06, 0.60), (0.25, 0.665), (0.40, 0.96), (0.50, 1.0), (0.80, 0.985),
     (0.92, 0.94), (0.98, 0.66), (0.99, 0.56), (1, 0.42)),
    (0.25, 0.40), (0.92, 0.98), 0.65, (0.29, 0.92), (0.50, 0.72), 0.36,
)  # fmt: skip
CAR_STYLES = (_HATCHBACK, _SALOON, _ESTATE, _OFF_ROADER)

_MINIBUS = BodyStyle(
    "Van", 0.5, (4.40, 5.10), (1.80, 1.95), (1.82, 2.05),
    ((0, 0.30), (0.012, 0.40), (0.10, 0.50), (0.17, 0.56), (0.33, 0.94), (0.40, 1.0), (0.90, 0.99),
     (0.965, 0.95), (0.99, 0.56), (1, 0.32)),
    (0.17, 0.33), (0.965, 0.99), 0.56, (0.20, 0.95), (0.42, 0.66),
)  # fmt: skip
_PANEL_VAN = BodyStyle(
    "Van", 0.5, (4.90, 5.90), (1.90, 2.02), (2.05, 2.60),
    ((0, 0.26), (0.01, 0.36), (0.09, 0.44), (0.14, 0.50), (0.27, 0.86), (0.36, 0.97), (0.45, 1.0),
     (0.97, 0.99), (0.985, 0.95), (0.993, 0.48), (1, 0.30)),
    (0.14, 0.27), (2, 2), 0.50, (0.17, 0.36), (), 0.34,
)  # fmt: skip
VAN_STYLES = (_MINIBUS, _PANEL_VAN)

_CAB = BodyStyle(
    "Truck", 1.0, (1.9, 2.2), (2.3, 2.5), (2.3, 2.7),
    ((0, 0.44), (0.02, 0.50), (0.05, 0.54), (0.16, 0.93), (0.30, 1.0), (0.93, 0.99), (1, 0.95)),
    (0.05, 0.16), (2, 2), 0.54, (0.12, 0.62), (),
)  # fmt: skip


def car(rng: np.random.Generator) -> Mesh:
    """A hatchback, saloon, estate or off-roader of random size and paint."""
    return _light_vehicle(rng, CAR_STYLES)


def van(rng: np.random.Generator) -> Mesh:
    """A minibus or a panel van."""
    return _light_vehicle(rng, VAN_STYLES)


def truck(rng: np.random.Generator) -> Mesh:
    """A rigid truck with a box body and two or three axles."""
    length, width = rng.uniform(6.0, 9.5), rng.uniform(2.35, 2.55)
    height, radius = rng.uniform(3.0, 3.7), 0.46
    paint, box = _paint(rng), _paint(rng)
    cab_length, cab_height = rng.uniform(*_CAB.length_m), min(rng.uniform(*_CAB.height_m), height - 0.2)
    cab = _shell(_CAB, cab_length, width - 0.1, cab_height - 0.35, paint, wheel_x=(), clearance=0.05)
    front = length / 2
    parts = [
        cab.moved((front - cab_length / 2, 0, 0.35)),
        _rounded_box(-front, front - cab_length - 0.15, width, 0.95, height, box),
        block((-front + 0.1, -0.45, 0.6), (front - 0.3, 0.45, 0.95), _TRIM),
        block((-front + 0.03, -width / 2 + 0.1, 0.45), (-front + 0.13, width / 2 - 0.1, 0.6), _TRIM),
        block((-front - 0.005, -width / 2 + 0.15, 0.75), (-front + 0.05, -width / 2 + 0.5, 0.9), _TAILLIGHT),
        block((-front - 0.005, width / 2 - 0.5, 0.75), (-front + 0.05, width / 2 - 0.15, 0.9), _TAILLIGHT),
    ]
    axles = [front - 1.2, -front + 1.5] + ([-front + 2.7] if length > 8 else [])
    parts += _wheels(axles, width - 0.1, radius, 0.32)
    return joined(parts)


def _light_vehicle(rng: np.random.Generator, styles: tuple[BodyStyle, ...]) -> Mesh:
    shares = np.array([style.share for style in styles])
    style = styles[rng.choice(len(styles), p=shares / shares.sum())]
    length, width = rng.uniform(*style.length_m), rng.uniform(*style.width_m)
    height, paint = rng.uniform(*style.height_m), _paint(rng)
    radius = style.wheel_radius_m
    axles = (length / 2 - rng.uniform(0.78, 0.88), -length / 2 + rng.uniform(0.68, 0.85))
    parts = [_shell(style, length, width, height, paint, axles, clearance=0.19)]
    parts += _wheels(axles, width, radius, 0.19)
    parts += _lights(style, length, width, height)
    parts += _seats(style, length, width, height)
    return joined(parts)


def _paint(rng: np.random.Generator) -> Surface:
    shares = np.array([share for _, _, share in _PAINTS])
    rgb, reflectance, _ = _PAINTS[rng.choice(len(_PAINTS), p=shares / shares.sum())]
    tint = np.clip(np.array(rgb) * rng.uniform(0.8, 1.2) * rng.normal(1, 0.03, 3), 0, 0.8)
    return Surface((float(tint[0]), float(tint[1]), float(tint[2])), reflectance, Material.GLOSSY)


def _shell(
    style: BodyStyle,
    length: float,
    width: float,
    height: float,
    paint: Surface,
    wheel_x: tuple[float, ...],
    clearance: float,
) -> Mesh:
    """The body skin: rings across the car, from the front bumper to the rear one."""
    arch_radius = style.wheel_radius_m + 0.05
    arch_x = [x + arch_radius * np.cos(a) for x in wheel_x for a in np.linspace(0, np.pi, 9)]
    share = np.unique(
        np.concatenate(
            [
                np.linspace(0, 1, 21),
                [at for at, _ in style.profile],
                [0.5 - x / length for x in arch_x],
                [pillar + side for pillar in style.pillars for side in (-0.014, 0.014)],
                np.array(style.glazed),
                np.array([0.03, 0.06, 0.12]) / length,
                1 - np.array([0.03, 0.06, 0.12]) / length,
            ]
        ).round(4)
    )
    share = share[(share >= 0) & (share <= 1)]
    x = length * (0.5 - share)
    profile = np.array(style.profile)
    top = height * np.interp(share, profile[:, 0], profile[:, 1])

    # In plan view the corners are round and the ends slightly bowed.
    from_front, from_rear = length * share, length * (1 - share)
    half = width / 2 * (1 - 0.30 * (1 - np.minimum(from_front / 0.65, 1)) ** 2.4)
    half *= 1 - 0.20 * (1 - np.minimum(from_rear / 0.45, 1)) ** 2.4

    sill = np.full_like(x, clearance)
    for wheel in wheel_x:
        inside = np.maximum(arch_radius**2 - (x - wheel) ** 2, 0)
        sill = np.maximum(sill, np.where(inside > 1e-6, style.wheel_radius_m + np.sqrt(inside), 0))
    bumper = 0.06 * (1 - np.minimum(np.minimum(from_front, from_rear) / 0.25, 1))
    sill = np.maximum(sill, clearance + bumper)

    belt = np.minimum(height * style.belt, top - 0.05)
    waist = np.clip(0.40 * height, sill + 0.02, np.maximum(belt - 0.03, sill + 0.02))
    rail = np.maximum(top - 0.07, belt + 0.01)
    lean = 0.30 * np.maximum(rail - belt, 0)
    zero = np.zeros_like(x)
    left_y = [zero, 0.94 * half, half, 0.97 * half, 0.96 * half - lean, 0.86 * half - 1.1 * lean, zero]
    left_z = [zero + clearance, sill, waist, belt, rail, top - 0.015, top]
    order = [0, 1, 2, 3, 4, 5, 6, 5, 4, 3, 2, 1]
    side = np.array([1, 1, 1, 1, 1, 1, 1, -1, -1, -1, -1, -1])
    y = np.stack([left_y[i] for i in order], axis=1) * side
    z = np.stack([left_z[i] for i in order], axis=1)
    rings = np.stack([np.repeat(x[:, None], 12, axis=1), y, z], axis=-1)
    return loft(rings, (paint, _GLASS, _TRIM), _panels(style, share, top, belt), caps=(0, 0))


def _panels(style: BodyStyle, share: Floats, top: Floats, belt: Floats) -> NDArray[np.int64]:
    """(stations - 1, 12) surface of each panel: 0 paint, 1 glass, 2 trim."""
    middle = (share[:-1] + share[1:]) / 2
    panels = np.zeros((len(middle), 12), dtype=np.int64)
    panels[:, 0] = panels[:, 11] = 2
    cabin = np.minimum((top - belt)[:-1], (top - belt)[1:]) > 0.12
    side_glass = cabin & (style.glazed[0] < middle) & (middle < style.glazed[1])
    for pillar in style.pillars:
        side_glass &= np.abs(middle - pillar) > 0.014
    panels[side_glass, 3] = panels[side_glass, 8] = 1
    for low, high in (style.windscreen, style.rear_window):
        glazed = (low < middle) & (middle < high)
        panels[glazed, 5] = panels[glazed, 6] = 1
    return panels


def _wheels(axles: tuple[float, ...] | list[float], width: float, radius: float, tread: float) -> list[Mesh]:
    parts = []
    for x in axles:
        for side in (-1, 1):
            y = side * (width / 2 - 0.02 - tread / 2)
            parts.append(disc((x, y, radius), radius, tread, _TYRE))
            parts.append(disc((x, y + side * 0.01, radius), 0.62 * radius, tread, _RIM, 12))
    return parts


def _lights(style: BodyStyle, length: float, width: float, height: float) -> list[Mesh]:
    parts = []
    for side in (-1, 1):
        inner, outer = sorted((side * 0.18 * width, side * 0.345 * width))
        front_z = style.profile[0][1] * height - 0.12  # below the edge of the bonnet
        rear_z = style.profile[-1][1] * height - 0.13
        parts.append(
            block((length / 2 - 0.2, inner, front_z), (length / 2 + 0.006, outer, front_z + 0.11), _HEADLIGHT)
        )
        inner, outer = sorted((side * 0.25 * width, side * 0.395 * width))
        parts.append(
            block((-length / 2 - 0.006, inner, rear_z), (-length / 2 + 0.2, outer, rear_z + 0.13), _TAILLIGHT)
        )
    for end in (-1, 1):
        x1, x2 = sorted((end * (length / 2 - 0.1), end * (length / 2 + 0.008)))
        parts.append(block((x1, -0.26, 0.33), (x2, 0.26, 0.44), _PLATE))
        parts.append(block((x1, -0.38 * width, 0.24), (x2 - 0.004 * end, 0.38 * width, 0.31), _TRIM))
    return parts


def _seats(style: BodyStyle, length: float, width: float, height: float) -> list[Mesh]:
    """What a beam meets that went through a window."""
    parts = []
    for share in (0.52, 0.75) if style.glazed[1] > 0.7 else (0.36,):
        x = length * (0.5 - share)
        for side in (-1, 1):
            y1, y2 = sorted((side * 0.08 * width, side * 0.36 * width))
            parts.append(block((x - 0.14, y1, 0.3 * height), (x, y2, 0.76 * height), _SEAT))
    return parts


def _rounded_box(x1: float, x2: float, width: float, z1: float, z2: float, surface: Surface) -> Mesh:
    """A cargo box whose long edges and corners are rounded."""
    radius, half = 0.06, width / 2
    ring = []
    for cy, cz, start in (
        (half - radius, z2 - radius, 0.0),
        (-half + radius, z2 - radius, np.pi / 2),
        (-half + radius, z1 + radius, np.pi),
        (half - radius, z1 + radius, 1.5 * np.pi),
    ):
        ring += [
            (cy + radius * np.cos(start + a), cz + radius * np.sin(start + a))
            for a in (0, np.pi / 4, np.pi / 2)
        ]
    outline = np.array(ring)
    middle = np.array([0.0, (z1 + z2) / 2])
    rings = []
    for x, inset in ((x1, 0.04), (x1 + 0.04, 0), (x2 - 0.04, 0), (x2, 0.04)):
        shrunk = middle + (outline - middle) * (1 - inset / half)
        rings.append(np.column_stack([np.full(len(outline), x), shrunk]))
    return loft(np.array(rings), (surface,))
