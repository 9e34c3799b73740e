"""The WeakM3D losses in the bird's-eye view: batched over objects and candidates, differentiable.

Equations are those of Peng et al., "WeakM3D" (ICLR 2022). One implementation serves the fit, where
thousands of candidate centres are tried per object, and network training, where gradients flow.

Shapes: `...` is any leading shape, usually (objects,) or (candidates, objects); all arguments of a
function broadcast over it. M is the number of points per object, padded where objects have fewer.

    points_xz   (..., M, 2)  object-LiDAR-points as (x, z) in the rectified camera frame, metres
    valid       (..., M)     bool, False where a point is padding
    origin_xz   (..., 2)     where the rays start: the camera's optical centre, or the LiDAR's
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


class BalancedLoss(NamedTuple):
    """Balanced loss of equation 5 and its unweighted, unbalanced means for the reader; all (...)."""

    total: Tensor
    geometric: Tensor
    ray_tracing: Tensor
    center: Tensor


def geometric_alignment(points_xz: Tensor, boxes: BevBoxes) -> Tensor:
    """L1 distance (..., M) from each point to where the ray from the box centre leaves the box (eq. 2).

    A point exactly at the centre has no ray of its own; it is sent out through the side of the box.
    """
    x, z = boxes.offset(points_xz)
    along, across = boxes.to_box_frame(x, z)
    half_width = boxes.width[..., None] / 2
    # The ray p = s * e leaves the box at e, where the larger of its two relative coordinates is one.
    s = torch.maximum(along.abs() * (2 / boxes.length[..., None]), across.abs() / half_width)
    length = x.abs() + z.abs()
    distance = (length - length / s.clamp(min=_EPS)).abs()
    side = half_width * (torch.sin(boxes.rotation_y).abs() + torch.cos(boxes.rotation_y).abs())[..., None]
    return torch.where(s < _EPS, side, distance)


def ray_tracing(points_xz: Tensor, boxes: BevBoxes, origin_xz: Tensor) -> tuple[Tensor, Tensor]:
    """L1 distance (..., M) from each point to the nearer hit of its ray on the box, and the hits (eq. 3).

    The distance is 0 where the ray misses. From an origin inside the box the ray leaves through the
    only side in front of it. The slab test of Kay and Kajiya (1986), in box coordinates.
    """
    starts = boxes.to_box_frame(*boxes.offset(origin_xz[..., None, :]))
    ray_x, ray_z = (points_xz - origin_xz[..., None, :]).unbind(-1)
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
    squared = x * x + z * z
    at_center = squared < _EPS**2
    return torch.where(at_center, 0.0, torch.where(at_center, 1.0, squared).sqrt())


def point_density(points_xz: Tensor, valid: Tensor, radius_m: float) -> Tensor:
    """Points (..., M) closer than `radius_m` in the bird's-eye view, the point itself included (eq. 4).

    At least 1 everywhere, so that padding never divides by zero.
    """
    squared = (points_xz[..., :, None, :] - points_xz[..., None, :, :]).square().sum(-1)
    neighbours = (squared < radius_m**2) & valid[..., None, :]
    return neighbours.sum(-1).clamp(min=1).to(points_xz.dtype)


def balanced_loss(
    points_xz: Tensor,
    valid: Tensor,
    boxes: BevBoxes,
    origin_xz: Tensor,
    settings: LossSettings,
    density: Tensor | None = None,
) -> BalancedLoss:
    """The balanced loss (equation 5) of each box (...), averaged over its valid points.

    `density` (..., M) may be given where many candidates share their points; else it is computed.
    A box without any valid point has loss 0.
    """
    weight = valid.to(points_xz.dtype)
    count = weight.sum(-1).clamp(min=1)
    geometric = geometric_alignment(points_xz, boxes)
    ray, hit = ray_tracing(points_xz, boxes, origin_xz)
    center = center_distance(points_xz, boxes, settings.center_norm)
    if not settings.balance_by_density:
        balance = weight
    elif density is None:
        balance = weight / point_density(points_xz, valid, settings.density_radius_m)
    else:
        balance = weight / density

    pointwise = settings.geometric_weight * geometric + settings.center_weight * center
    total = (pointwise * balance).sum(-1) / count
    ray_scale = settings.ray_weight / count
    if settings.ray_average == "hits" or settings.ray_min_hits or settings.ray_min_depth_m:
        hits = (hit & valid).sum(-1)
        if settings.ray_average == "hits":
            ray_scale = settings.ray_weight / hits.clamp(min=1)
        counts = (hits >= settings.ray_min_hits) & (boxes.center_xz[..., 1] > settings.ray_min_depth_m)
        ray_scale = torch.where(counts, ray_scale, 0.0)
    total = total + (ray * balance).sum(-1) * ray_scale
    means = ((term * weight).sum(-1) / count for term in (geometric, ray, center))
    return BalancedLoss(total, *means)
