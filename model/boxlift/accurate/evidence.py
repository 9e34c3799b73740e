"""How well a box explains what camera and LiDAR saw of a prompt: what decides between hypotheses.

Rays follow the beam model of range finders (Thrun, Burgard and Fox, "Probabilistic Robotics", 2005,
section 6.3): a ray ends on the box, falls short of it, goes through it (strong evidence against it), or
misses it. weights.py says where the weights come from.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from boxlift.accurate.parameters import (
    BOTTOM,
    HEIGHT,
    LENGTH,
    WIDTH,
    X,
    Z,
    to_box_frame,
)
from boxlift.accurate.polish import (
    GROUND_M,
    INSIDE_M,
    OUTSIDE_M,
    POINT_CAP,
    SizePull,
    edge_errors,
    outline_distance,
)
from boxlift.accurate.view import Region, View
from boxlift.camera import Floats

# Rays have to cross this share of the box's sides: corners are rounded.
_SOLID = 0.9
# Above this share of its height a vehicle has windows.
_BODY = 0.6
_ON_M, _CORE_M, _RING_M = 0.2, 0.15, 0.6
_DEEP_M = 0.8
_EDGE_HUBER = 2.0
_PRIOR_CAUCHY = 2.0


@dataclass(frozen=True)
class Evidence:
    """What speaks for and against B boxes, each (B,).

    sides, vertical: errors of the projected edges. length, width, height, ground: how far size and bottom
    are off their priors. on, short, through, beside, behind: shares of the prompt's rays that end on the
    box, before it, went through its body, or miss it and end nearer or farther than its centre. span: log
    share of the prompt's width that the points on the box cover. contained: share of the points in the
    box that lie in the prompt. spill: share of points just outside the box among those in and around it.
    count: log number of points in the box. misfit: of the points on the box from its outline.
    """

    sides: Floats
    vertical: Floats
    length: Floats
    width: Floats
    height: Floats
    ground: Floats
    on: Floats
    short: Floats
    through: Floats
    beside: Floats
    behind: Floats
    span: Floats
    contained: Floats
    spill: Floats
    count: Floats
    misfit: Floats

    def matrix(self) -> Floats:
        """(B, F) in the order of the fields."""
        return np.stack([getattr(self, field.name) for field in fields(self)], axis=1)

    def energy(self, weights: dict[str, float]) -> Floats:
        """(B,) the weighted sum: the lower, the likelier the box."""
        total: Floats = sum((weights[name] * getattr(self, name) for name in weights), start=np.zeros(1))
        return total


def weigh(
    view: View,
    region: Region,
    parameters: Floats,
    size: SizePull,
    *,
    use_edges: bool,
) -> Evidence:
    """Evidence on boxes (B, 7) from the region of a prompt."""
    frame = view.frame
    inside_xz = view.points_cam[region.inside][:, [0, 2]]
    on, short, through, beside, behind, is_on = _rays(view, region, parameters)
    columns_px = view.pixels[region.inside, 0]
    left = np.where(is_on, columns_px, np.inf).min(1, initial=np.inf)
    right = np.where(is_on, columns_px, -np.inf).max(1, initial=-np.inf)
    span = np.log(((right - left) / max(region.width_px, 1.0)).clip(0.02, 1))

    outline = outline_distance(parameters, view.points_cam[region.around][:, [0, 2]])
    core = outline < _CORE_M
    ring = (outline < _RING_M) & ~core
    in_core = core.sum(1)
    sampled = region.found_around / max(len(region.around), 1)

    image_P_cam = frame.calibration.image_P_cam
    errors, _ = edge_errors(parameters, region.box_px, frame.image_size_px, image_P_cam)
    errors = _EDGE_HUBER**2 * (np.sqrt(1 + (errors / _EDGE_HUBER) ** 2) - 1) * use_edges
    off_size = (parameters[:, LENGTH : HEIGHT + 1] - size.lwh_m) / size.sigma_m
    off_ground = (parameters[:, BOTTOM] - view.ground.y_at(parameters[:, X], parameters[:, Z])) / GROUND_M
    priors = _PRIOR_CAUCHY**2 * np.log1p((np.column_stack([off_size, off_ground]) / _PRIOR_CAUCHY) ** 2)
    distance = outline_distance(parameters, inside_xz)
    squared = (distance / np.where(distance > 0, OUTSIDE_M, INSIDE_M)) ** 2
    misfit = (POINT_CAP * squared / (POINT_CAP + squared) * is_on).sum(1) / is_on.sum(1).clip(1)
    return Evidence(
        sides=errors[:, 0] + errors[:, 2],
        vertical=errors[:, 1] + errors[:, 3],
        length=priors[:, 0],
        width=priors[:, 1],
        height=priors[:, 2],
        ground=priors[:, 3],
        on=on,
        short=short,
        through=through,
        beside=beside,
        behind=behind,
        span=span,
        contained=(core & region.around_inside).sum(1) / in_core.clip(1),
        spill=ring.sum(1) / (in_core + ring.sum(1)).clip(1),
        count=np.log1p(in_core * sampled),
        misfit=misfit,
    )


def _rays(
    view: View, region: Region, parameters: Floats
) -> tuple[Floats, Floats, Floats, Floats, Floats, NDArray[np.bool_]]:
    """Shares (B,) of rays on, short of, through, beside (nearer) and behind the box; and (B, M) on it."""
    points = view.points_cam[region.inside]
    sensor = view.sensor_cam
    along, across = to_box_frame(parameters, points[:, [0, 2]])
    from_along, from_across = to_box_frame(parameters, sensor[None, [0, 2]])
    is_on = (np.abs(along) < parameters[:, LENGTH, None] / 2 + _ON_M) & (
        np.abs(across) < parameters[:, WIDTH, None] / 2 + _ON_M
    )
    enter, leave = np.full(along.shape, -np.inf), np.full(along.shape, np.inf)
    for start, end, side in (
        (from_along, along, parameters[:, LENGTH, None]),
        (from_across, across, parameters[:, WIDTH, None]),
    ):
        ray = end - start
        inverse = 1 / np.where(np.abs(ray) < 1e-6, 1e-6, ray)
        middle, reach = -start * inverse, _SOLID / 2 * side * np.abs(inverse)
        enter, leave = np.maximum(enter, middle - reach), np.minimum(leave, middle + reach)
    crosses = (enter < leave) & (leave > 0)
    # Height of the ray over the box's bottom where it enters and leaves: rays from a roof look down.
    sensor_height = parameters[:, BOTTOM, None] - sensor[1]
    rise = sensor[1] - points[:, 1]
    lowest = sensor_height + np.minimum(enter * rise, leave * rise)
    is_low = lowest < _BODY * parameters[:, HEIGHT, None]
    # A ray that ends deep behind all sides that the sensor sees went through the body to get there.
    is_deep = (
        is_on & is_low & (_from_seen_sides(parameters, along, across, from_along, from_across) < -_DEEP_M)
    )
    is_on &= ~is_deep
    hit = crosses & ~is_on & ~is_deep
    missed = ~crosses & ~is_on & ~is_deep
    through = is_deep | (hit & (leave < 1) & is_low)
    farther = np.hypot(along - from_along, across - from_across) > np.hypot(from_along, from_across)
    # Beyond the image's border nobody says that there is only the object.
    seen = region.inside_image if region.inside_image.any() else np.ones(len(points), dtype=np.bool_)
    shares = (is_on, hit & (enter > 1), through, missed & ~farther, missed & farther)
    on, short, went_through, beside, behind = (share[:, seen].mean(1) for share in shares)
    return on, short, went_through, beside, behind, is_on


def _from_seen_sides(
    parameters: Floats, along: Floats, across: Floats, from_along: Floats, from_across: Floats
) -> Floats:
    """(B, M) signed distance of points beyond the sides that face the sensor; negative inside."""
    ends = np.sign(from_along) * along - parameters[:, LENGTH, None] / 2
    flanks = np.sign(from_across) * across - parameters[:, WIDTH, None] / 2
    sees_end = np.abs(from_along) > parameters[:, LENGTH, None] / 2
    sees_flank = np.abs(from_across) > parameters[:, WIDTH, None] / 2
    distance: Floats = np.maximum(np.where(sees_end, ends, -np.inf), np.where(sees_flank, flanks, -np.inf))
    return np.where(sees_end | sees_flank, distance, 0.0)
