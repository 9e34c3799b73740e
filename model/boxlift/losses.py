"""The WeakM3D losses in the bird's-eye view: batched over objects and candidates, differentiable.

Equations are those of Peng et al., "WeakM3D" (ICLR 2022). One implementation serves the fit, where
thousands of candidate centres are tried per object, and network training, where gradients flow.

Shapes: `...` is any leading shape, usually (objects,) or (candidates, objects); all arguments of a
function broadcast over it. M is the number of points per object, padded where objects have fewer.

    points_xz   (..., M, 2)  object-LiDAR-points as (x, z) in the rectified camera frame, metres
    valid       (..., M)     bool, False where a point is padding
    origin_xz   (..., 2)     where the rays start: the camera's optical centre, or the LiDAR's; of points
                             that were seen from several places (..., M, 2), as many axes as points_xz
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from boxlift.settings import LossSettings

# Guards against division by zero; far below the millimetre that LiDAR resolves.
_EPS = 1e-6


@dataclass(frozen=True)
class BevBoxes:
    """Boxes in the bird's-eye view, any leading shape.

    center_xz (..., 2) and length, width (...) in metres, rotation_y (...) in radians; the heading is
    (cos, -sin) of rotation_y in (x, z).
    """

    center_xz: Tensor
    length: Tensor
    width: Tensor
    rotation_y: Tensor

    def to_box_frame(self, x: Tensor, z: Tensor) -> tuple[Tensor, Tensor]:
        """Components (..., M) of vectors in camera axes -> along the box's length and across it."""
        cos, sin = torch.cos(self.rotation_y)[..., None], torch.sin(self.rotation_y)[..., None]
        return cos * x - sin * z, sin * x + cos * z

    def offset(self, points_xz: Tensor) -> tuple[Tensor, Tensor]:
        """x and z (..., M) of the points (..., M, 2) as seen from the box centre."""
        center = self.center_xz[..., None, :]
        return points_xz[..., 0] - center[..., 0], points_xz[..., 1] - center[..., 1]


class PointLosses(NamedTuple):
    """The losses of each point (..., M), metres, and whether its ray hits the box."""

    geometric: Tensor
    ray_tracing: Tensor
    center: Tensor
    hit: Tensor

    def means(self, valid: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Geometric, ray-tracing and centre loss (...) averaged over the valid points, for the reader."""
        weight = valid.to(self.geometric.dtype)
        geometric, ray, center = (
            (loss * weight).sum(-1) / weight.sum(-1).clamp(min=1)
            for loss in (self.geometric, self.ray_tracing, self.center)
        )
        return geometric, ray, center


def geometric_alignment(points_xz: Tensor, boxes: BevBoxes) -> Tensor:
    """L1 distance (..., M) from each point to where the ray from the box centre leaves the box (eq. 2).

    A point exactly at the centre has no ray of its own; it is sent out through the side of the box.
    """
    x, z = boxes.offset(points_xz)
    along, across = boxes.to_box_frame(x, z)
    # All points move sideways by a micrometre: it shows only where the offset itself is zero.
    nudge = _EPS * (torch.sin(boxes.rotation_y).abs() + torch.cos(boxes.rotation_y).abs())[..., None]
    distance = x.abs() + z.abs() + nudge
    # The ray p = s * e leaves the box at e, where the larger of its two relative coordinates is one.
    s = torch.maximum(
        along.abs() * (2 / boxes.length[..., None]), (across.abs() + _EPS) * (2 / boxes.width[..., None])
    )
    return (distance - distance / s).abs()


def ray_tracing(points_xz: Tensor, boxes: BevBoxes, origin_xz: Tensor) -> tuple[Tensor, Tensor]:
    """L1 distance (..., M) from each point to the nearer hit of its ray on the box, and the hits (eq. 3).

    The distance is 0 where the ray misses. From an origin inside the box the ray leaves through the
    only side in front of it. The slab test of Kay and Kajiya (1986), in box coordinates.
    """
    origins_xz = origin_xz if origin_xz.dim() == points_xz.dim() else origin_xz[..., None, :]
    starts = boxes.to_box_frame(*boxes.offset(origins_xz))
    ray_x, ray_z = (points_xz - origins_xz).unbind(-1)
    rays = boxes.to_box_frame(ray_x, ray_z)
    enter, leave = [], []
    for start, ray, extent in zip(starts, rays, (boxes.length, boxes.width), strict=True):
        inverse = 1 / torch.where(ray.abs() < _EPS, _EPS, ray)
        half = extent[..., None] / 2
        middle, reach = -start * inverse, half * inverse.abs()
        enter.append(middle - reach)
        leave.append(middle + reach)
    near, far = torch.maximum(*enter), torch.minimum(*leave)
    hit = (near <= far) & (far > 0)
    at = torch.where(near > 0, near, far)
    distance = (at - 1).abs() * (ray_x.abs() + ray_z.abs())
    return torch.where(hit, distance, 0.0), hit


def center_distance(points_xz: Tensor, boxes: BevBoxes, norm: str = "euclidean") -> Tensor:
    """Distance (..., M) from each point to the box centre: Euclidean (paper) or L1 (release)."""
    x, z = boxes.offset(points_xz)
    if norm == "l1":
        return x.abs() + z.abs()
    # The constant keeps the gradient at the centre finite and moves no value by more than a micrometre.
    return (x * x + z * z + _EPS**2).sqrt()


def point_density(points_xz: Tensor, valid: Tensor, radius_m: float) -> Tensor:
    """Points (..., M) closer than `radius_m` in the bird's-eye view, the point itself included (eq. 4).

    At least 1 everywhere, so that padding never divides by zero.
    """
    squared = (points_xz[..., :, None, :] - points_xz[..., None, :, :]).square().sum(-1)
    neighbours = (squared < radius_m**2) & valid[..., None, :]
    return neighbours.sum(-1).clamp(min=1).to(points_xz.dtype)


def point_losses(
    points_xz: Tensor, boxes: BevBoxes, origin_xz: Tensor, settings: LossSettings
) -> PointLosses:
    """All losses of each point, neither weighted nor balanced."""
    ray, hit = ray_tracing(points_xz, boxes, origin_xz)
    return PointLosses(
        geometric=geometric_alignment(points_xz, boxes),
        ray_tracing=ray,
        center=center_distance(points_xz, boxes, settings.center_norm),
        hit=hit,
    )


def balanced_loss(
    points_xz: Tensor,
    valid: Tensor,
    boxes: BevBoxes,
    origin_xz: Tensor,
    settings: LossSettings,
    density: Tensor | None = None,
) -> Tensor:
    """The balanced loss (...) of each box (equation 5), averaged over its valid points.

    `density` (..., M) may be given where many candidates share their points; else it is computed.
    A box without any valid point has loss 0.
    """
    losses = point_losses(points_xz, boxes, origin_xz, settings)
    balance = valid.to(points_xz.dtype)
    count = balance.sum(-1).clamp(min=1)
    if settings.balance_by_density:
        if density is None:
            density = point_density(points_xz, valid, settings.density_radius_m)
        balance = balance / density
    pointwise = settings.geometric_weight * losses.geometric + settings.center_weight * losses.center
    ray_scale = _ray_scale(losses.hit, valid, count, boxes, settings)
    return (pointwise * balance).sum(-1) / count + (losses.ray_tracing * balance).sum(-1) * ray_scale


def _ray_scale(hit: Tensor, valid: Tensor, count: Tensor, boxes: BevBoxes, settings: LossSettings) -> Tensor:
    """What the sum of ray losses is multiplied by: 1 / count in the paper, by hits in the release."""
    if settings.ray_average == "all" and not settings.ray_min_hits and not settings.ray_min_depth_m:
        return settings.ray_weight / count
    hits = (hit & valid).sum(-1)
    averaged_over = hits.clamp(min=1) if settings.ray_average == "hits" else count
    applies = (hits >= settings.ray_min_hits) & (boxes.center_xz[..., 1] > settings.ray_min_depth_m)
    return torch.where(applies, settings.ray_weight / averaged_over, 0.0)
