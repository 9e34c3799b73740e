"""After the fit: position, heading and size move a little until points, prompt and priors agree.

Damped Gauss-Newton (Levenberg, 1944; Marquardt, 1963) on robust residuals, all boxes of a prompt at once:
distances of points from the outline seen from above, the edges of the projected box against the
prompt's, and priors for the size, the bottom (local ground) and the heading.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxlift.accurate.parameters import (
    HEIGHT,
    LENGTH,
    WIDTH,
    YAW,
    project_edges,
    to_box_frame,
)
from boxlift.camera import Floats

# Standard deviations (ours). Points lie inside an outline that mirrors and rounded corners blur.
OUTSIDE_M, INSIDE_M = 0.07, 0.3
# A point never costs more than this many variances: it is of something else (Geman and McClure, 1985).
POINT_CAP = 9.0
# All points of an object together weigh as much as this many: their errors are not independent.
POINTS_WORTH = 10.0
# Edges of prompts: this many pixels, and this share of the prompt's size.
_EDGE_PX, _EDGE_SHARE = 2.0, 0.015
# Edge errors beyond this many standard deviations count by their logarithm (Cauchy).
_EDGE_CAUCHY = 2.0
GROUND_M, _UNKNOWN_GROUND_M = 0.08, 0.3
YAW_RAD = 0.5
_LARGEST_STEP = 0.5
_SMALLEST_SIDE_M = 0.2


@dataclass(frozen=True)
class SizePull:
    """Where the size is pulled to, (3,) length, width, height in metres, and how far it may be off."""

    lwh_m: Floats
    sigma_m: Floats


@dataclass(frozen=True)
class Target:
    """What B boxes are pulled to, each to its own.

    points_xz (B, M, 2) with weights (B, M), 0 where a point is padding. box_px (B, V, 4) the prompts of V
    viewpoints, cut to the image, which the projected box is cut to as well: an edge beyond the border costs
    nothing. lwh_m, sigma_m (B, 3) the size and how far it may be off. bottom_y, bottom_sigma_m (B,) the same
    for the ground. inside_m: how far points may lie inside the outline. yaw_rad: how far the heading may
    turn.
    """

    points_xz: Floats
    weights: Floats
    box_px: Floats
    lwh_m: Floats
    sigma_m: Floats
    bottom_y: Floats
    bottom_sigma_m: Floats
    inside_m: float = INSIDE_M
    yaw_rad: float = YAW_RAD

    @classmethod
    def of_one(
        cls,
        points_xz: Floats,
        weights: Floats,
        box_px: Floats,
        size: SizePull,
        bottom_y: Floats,
        ground_is_known: NDArray[np.bool_],
    ) -> Target:
        """The target of B hypotheses on one object: points (M, 2), weights (M,), boxes (V, 4) or, of a single
        view, (4,); ground (B,)."""
        count = len(bottom_y)
        points, weight, box, lwh, sigma = (
            np.broadcast_to(one, (count, *one.shape))
            for one in (points_xz, weights, box_px.reshape(-1, 4), size.lwh_m, size.sigma_m)
        )
        bottom_sigma_m = np.where(ground_is_known, GROUND_M, _UNKNOWN_GROUND_M)
        return cls(points, weight, box, lwh, sigma, bottom_y, bottom_sigma_m)

    @classmethod
    def joined(cls, targets: Sequence[Target]) -> Target:
        """Targets one after the other, points padded to the largest number; the rest is the first's."""
        most = max(target.weights.shape[1] for target in targets)

        def padded(array: Floats) -> Floats:
            widths = [(0, 0)] * array.ndim
            widths[1] = (0, most - array.shape[1])
            return np.pad(array, widths)

        return cls(
            np.concatenate([padded(target.points_xz) for target in targets]),
            np.concatenate([padded(target.weights) for target in targets]),
            **{
                name: np.concatenate([getattr(target, name) for target in targets])
                for name in ("box_px", "lwh_m", "sigma_m", "bottom_y", "bottom_sigma_m")
            },
            inside_m=targets[0].inside_m,
            yaw_rad=targets[0].yaw_rad,
        )


@dataclass(frozen=True)
class Viewpoint:
    """What the polish knows of a camera.

    image_P_cam: (3, 4) from the frame of the boxes. weight: what the prompt's edges count, 0 for nothing.
    """

    image_P_cam: Floats
    image_size_px: tuple[int, int]
    weight: float = 1.0


def point_weights(points_xz: Floats, radius_m: float, worth: float = POINTS_WORTH) -> Floats:
    """(M,) inverse densities (paper, equation 4) that sum to what the points are worth."""
    apart = points_xz[:, None] - points_xz[None]
    near = (apart**2).sum(-1) < radius_m**2
    weights = 1 / near.sum(1).clip(1)
    scaled: Floats = weights / max(weights.sum(), 1e-9) * min(len(points_xz), worth)
    return scaled


def outline_distance(parameters: Floats, points_xz: Floats) -> Floats:
    """(B, M) signed distance of points (M, 2) beyond the nearest side of B boxes; negative inside."""
    along, across = to_box_frame(parameters, points_xz)
    beyond: Floats = np.maximum(
        np.abs(along) - parameters[:, LENGTH, None] / 2, np.abs(across) - parameters[:, WIDTH, None] / 2
    )
    return beyond


def edge_errors(
    parameters: Floats, box_px: Floats, image_size_px: tuple[int, int], image_P_cam: Floats
) -> tuple[Floats, Floats]:
    """Projected edges cut to the image minus the prompt's (B, 4), in standard deviations; derivatives.

    image_P_cam: (3, 4) from the frame of the boxes, see project_edges.
    """
    edges, derivative = project_edges(parameters, image_P_cam)
    width, height = image_size_px
    border = np.array([width - 1, height - 1, width - 1, height - 1])
    sides = box_px[..., [2, 3, 2, 3]] - box_px[..., [0, 1, 0, 1]]
    sigma = _EDGE_PX + _EDGE_SHARE * sides
    within = (edges > 0) & (edges < border)
    errors: Floats = (edges.clip(0, border) - box_px) / sigma
    slopes: Floats = derivative * within[..., None] / sigma[..., None]
    return errors, slopes


def polish(
    parameters: Floats, target: Target, viewpoints: Sequence[Viewpoint], steps: int
) -> tuple[Floats, Floats]:
    """(B, 7) -> (B, 7) boxes nearer to their target, and what they are still off, (B,) squares of standard
    deviations; a step that does not help is not taken."""
    current = parameters.copy()
    start_yaw = parameters[:, YAW].copy()
    damping = np.full(len(current), 1e-2)
    cost, normal, gradient = _linearised(current, start_yaw, target, viewpoints)
    for _ in range(steps):
        diagonal = normal.diagonal(axis1=1, axis2=2)
        damped = normal + (damping[:, None] * diagonal + 1e-6)[:, :, None] * np.eye(7)
        step = -np.linalg.solve(damped, gradient[..., None])[..., 0]
        moved = current + step.clip(-_LARGEST_STEP, _LARGEST_STEP)
        moved[:, LENGTH : HEIGHT + 1] = moved[:, LENGTH : HEIGHT + 1].clip(_SMALLEST_SIDE_M)
        new_cost, new_normal, new_gradient = _linearised(moved, start_yaw, target, viewpoints)
        better = new_cost < cost
        current[better], cost[better] = moved[better], new_cost[better]
        normal[better], gradient[better] = new_normal[better], new_gradient[better]
        damping = np.where(better, damping * 0.3, damping * 5)
    return current, cost


def _linearised(
    parameters: Floats, start_yaw: Floats, target: Target, viewpoints: Sequence[Viewpoint]
) -> tuple[Floats, Floats, Floats]:
    """Cost (B,), normal matrices (B, 7, 7) and gradients (B, 7), robust terms as reweighted squares."""
    cost, point_residual, point_slope = _point_terms(parameters, target)
    prior, prior_scale = _prior_terms(parameters, start_yaw, target)
    cost += (prior**2).sum(1)
    normal = prior_scale[:, :, None] ** 2 * np.eye(7)
    gradient = prior * prior_scale
    for view, viewpoint in enumerate(viewpoints):
        if not viewpoint.weight:
            continue
        edge, edge_slope = edge_errors(
            parameters, target.box_px[:, view], viewpoint.image_size_px, viewpoint.image_P_cam
        )
        scaled = (edge / _EDGE_CAUCHY) ** 2
        cost += viewpoint.weight * _EDGE_CAUCHY**2 * np.log1p(scaled).sum(1)
        weighted = edge_slope * (viewpoint.weight / (1 + scaled))[..., None]
        turned = weighted.transpose(0, 2, 1)
        normal += turned @ edge_slope
        gradient += (turned @ edge[..., None])[..., 0]
    seen = point_slope.shape[1]  # points see nothing of height and bottom
    normal[:, :seen, :seen] += point_slope @ point_slope.transpose(0, 2, 1)
    gradient[:, :seen] += (point_slope @ point_residual[..., None])[..., 0]
    return cost, normal, gradient


def _point_terms(parameters: Floats, target: Target) -> tuple[Floats, Floats, Floats]:
    """Cost (B,), reweighted residuals (B, M) and their slopes (B, 5, M) by x, z, yaw, length and width."""
    along, across = to_box_frame(parameters, target.points_xz)
    beyond_along = np.abs(along) - parameters[:, LENGTH, None] / 2
    beyond_across = np.abs(across) - parameters[:, WIDTH, None] / 2
    is_end = beyond_along > beyond_across
    distance = np.where(is_end, beyond_along, beyond_across)
    sigma = np.where(distance > 0, OUTSIDE_M, target.inside_m)
    squared = (distance / sigma) ** 2
    cost = (target.weights * POINT_CAP * squared / (POINT_CAP + squared)).sum(1)
    # Derivative of the capped cost by the squared residual, as a weight of the plain one.
    scale = np.sqrt(target.weights) * POINT_CAP / (POINT_CAP + squared) / sigma
    cos, sin = np.cos(parameters[:, YAW, None]), np.sin(parameters[:, YAW, None])
    scaled_sign = np.where(is_end, np.sign(along), np.sign(across)) * scale
    half = scale / -2
    slope = np.stack(
        [
            -scaled_sign * np.where(is_end, cos, sin),
            scaled_sign * np.where(is_end, sin, -cos),
            scaled_sign * np.where(is_end, -across, along),
            np.where(is_end, half, 0.0),
            np.where(is_end, 0.0, half),
        ],
        axis=1,
    )
    return cost, distance * scale, slope


def _prior_terms(parameters: Floats, start_yaw: Floats, target: Target) -> tuple[Floats, Floats]:
    """Priors as residuals (B, 7) in standard deviations, and one over those (B, 7); 0 without a prior."""
    nothing = np.zeros((len(parameters), 2))
    wanted = np.column_stack([nothing, start_yaw, target.lwh_m, target.bottom_y])
    yaw = np.full(len(parameters), 1 / target.yaw_rad)
    scale = np.column_stack([nothing, yaw, 1 / target.sigma_m, 1 / target.bottom_sigma_m])
    return (parameters - wanted) * scale, scale
