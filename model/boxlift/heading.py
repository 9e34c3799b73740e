"""Heading of an object from the directions between its points (paper, equation 7 and appendix)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boxlift.camera import Floats
from boxlift.settings import HeadingSettings


@dataclass(frozen=True)
class HeadingHypothesis:
    """A heading in [-pi, pi) and, should another be chosen, the reason why not this one."""

    rotation_y: float
    reason: str


def heading_hypotheses(
    used: Floats, cluster: Floats, settings: HeadingSettings
) -> tuple[HeadingHypothesis, ...]:
    """The headings of an object, the chosen one first, from its used (M, 3) and cluster (K, 3) points."""
    direction = main_direction(used, settings)
    extent_m = x_extent(used if settings.x_extent_of == "used" else cluster)
    chosen, perpendicular = resolve_heading(direction, extent_m, settings)
    longer = "longer" if extent_m > settings.x_extent_threshold_m else "not longer"
    reason = f"The points extend {extent_m:.1f} m along x, {longer} than {settings.x_extent_threshold_m:g} m."
    return (
        HeadingHypothesis(facing_away(chosen), reason),
        HeadingHypothesis(facing_away(perpendicular), reason),
    )


def main_direction(points_cam: Floats, settings: HeadingSettings) -> float:
    """The rotation_y, modulo pi in [0, pi), that most pairs of points (M, 3) share in the x-z plane.

    A direction atan(dz / dx) is the negative of KITTI's rotation_y. In the paper's histogram the answer is
    the mean of the directions in the highest bin; in the release it is the rounded direction.
    """
    first, second = np.triu_indices(len(points_cam), k=1)
    step = points_cam[first] - points_cam[second]
    apart = np.hypot(step[:, 0], step[:, 2]) > 1e-6
    directions = np.arctan2(-step[apart, 2], step[apart, 0]) % np.pi
    if len(directions) == 0:
        return np.pi / 2
    if settings.direction == "rounded":
        multiple = np.rint(directions / settings.bin_rad).astype(np.intp)
        return float(np.bincount(multiple).argmax() * settings.bin_rad % np.pi)
    bins = max(1, round(np.pi / settings.bin_rad))
    member = np.minimum((directions * bins / np.pi).astype(np.intp), bins - 1)
    peak = np.bincount(member, minlength=bins).argmax()
    return float(directions[member == peak].mean())


def resolve_heading(direction: float, x_extent_m: float, settings: HeadingSettings) -> tuple[float, float]:
    """(rotation_y, its perpendicular alternative) in [0, pi) from the main direction (equation 7).

    The direction is the object's length or width axis. It is first folded to around pi/2, as most
    objects drive along the viewing direction; an extent along x of more than C says that they do not.
    """
    low = settings.fold_low_rad
    folded = direction
    if not low <= folded <= np.pi - low:
        folded = (direction + np.pi / 2) % np.pi
    perpendicular = (folded + np.pi / 2) % np.pi
    if x_extent_m > settings.x_extent_threshold_m:
        return perpendicular, folded
    return folded, perpendicular


def x_extent(points_cam: Floats) -> float:
    """d_x of equation 7: the extent of the points (M, 3) along x, metres."""
    return float(np.ptp(points_cam[:, 0]))


def facing_away(rotation_y: float) -> float:
    """Of the two headings that points cannot tell apart, the one that drives away from the camera.

    The heading is (cos, -sin) of rotation_y in (x, z); in [-pi, 0] its z is not negative.
    """
    return rotation_y - np.pi if rotation_y > 0 else rotation_y
