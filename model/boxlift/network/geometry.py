"""What geometry alone says of a 2D box: how far away an object is that is as large as its class usually is.

Everything is in normalised camera coordinates (pixels less the principal point, over the focal length), so
that it means the same through any lens.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from boxlift.network.detections import CLASSES
from boxlift.priors import SIZE_PRIORS, SizeTemplate

# A box this near the border of the image is taken to go on beyond it.
_BORDER_PX = 3.0
# The line that bottoms of boxes follow, bottom = pitch + camera height / depth: where it lies where no car is
# in sight, and how far off that may be (standard deviations; ours: a camera on a car, level within a degree).
_CAMERA_HEIGHT_M, _CAMERA_HEIGHT_SPREAD_M = 1.65, 0.15
_PITCH_SPREAD = 0.015
# Of one car: its height may be 9 % off, an edge of its box 2 px at f = 700 (ours).
_HEIGHT_SPREAD = 0.09
_EDGE_SPREAD = 0.003
_REWEIGHTINGS = 5
# A ground line this little above the horizon (about 0.7 degrees) is nowhere.
_LEAST_DROP = 0.012
# Depth of the centre behind the nearest side, as a share of the length, for most headings on a road (ours).
_BEHIND_FACE = 0.45

FEATURES = 17 + len(CLASSES)


def typical_sizes() -> Tensor:
    """(classes, 3) length, width, height of a typical member of each class, as `accurate` starts from."""
    sizes = []
    for name in CLASSES:
        prior = SIZE_PRIORS[name]
        first: SizeTemplate | None = next(iter(prior.templates), None)
        size = first or prior
        sizes.append((size.length_m, size.width_m, size.height_m))
    return torch.tensor(sizes)


class Geometry(NamedTuple):
    """N boxes of one image. features (N, FEATURES); depth_m (N,): of the centre, from the frozen height."""

    features: Tensor
    depth_m: Tensor


class GroundLine(NamedTuple):
    """bottom = pitch + camera_height_m / depth, scalars, with their variances."""

    pitch: Tensor
    camera_height_m: Tensor
    pitch_variance: Tensor
    height_variance: Tensor


def describe(
    boxes_px: Tensor,
    categories: Tensor,
    scores: Tensor,
    image_P_cam: Tensor,
    image_size_px: tuple[Tensor, Tensor],
) -> Geometry:
    """boxes_px (N, 4), categories and scores (N,), image_P_cam (3, 4), width and height -> Geometry."""
    edges = normalised(boxes_px, image_P_cam)
    x1, y1, x2, y2 = edges.unbind(1)
    sizes = typical_sizes().to(boxes_px)[categories]
    length, car_height = sizes[:, 0], sizes[:, 2]
    height, width = (y2 - y1).clamp(min=0.004), (x2 - x1).clamp(min=0.004)
    beyond = torch.stack(
        [
            boxes_px[:, 0] < _BORDER_PX,
            boxes_px[:, 2] > image_size_px[0] - 1 - _BORDER_PX,
            boxes_px[:, 3] > image_size_px[1] - 1 - _BORDER_PX,
        ],
        1,
    ).to(boxes_px.dtype)
    of_class = torch.nn.functional.one_hot(categories, len(CLASSES)).to(boxes_px.dtype)
    trusted = of_class[:, 0] * scores * (beyond.sum(1) < 1)
    line = ground_line(y2, height / car_height, trusted)
    face = car_height / height
    by_line = line.camera_height_m / (y2 - line.pitch).clamp(min=_LEAST_DROP)
    flat = _CAMERA_HEIGHT_M / y2.clamp(min=_LEAST_DROP)
    depth = face + _BEHIND_FACE * length
    line_depth = by_line + _BEHIND_FACE * length
    everywhere = torch.ones_like(face)
    # Scaled so that each is of the order of one.
    columns = [
        1.5 * x1,
        3 * y1,
        1.5 * x2,
        3 * y2,
        torch.log(12 * height),
        torch.log(8 * width),
        torch.log(width / height),
        (3 * torch.log(line_depth / depth)).clamp(-3, 3),
        (2 * torch.log(flat / face)).clamp(-3, 3),
        30 * line.pitch * everywhere,
        4 * (line.camera_height_m - _CAMERA_HEIGHT_M) * everywhere,
        50 * line.pitch_variance.sqrt() * everywhere,
        5 * line.height_variance.sqrt() * everywhere,
        *beyond.unbind(1),
        2 * scores - 0.8,
    ]
    return Geometry(torch.cat([torch.stack(columns, 1), of_class], 1), depth)


def normalised(boxes_px: Tensor, image_P_cam: Tensor) -> Tensor:
    """(N, 4) x1, y1, x2, y2 in pixels -> in normalised camera coordinates (tangents)."""
    focal = torch.stack([image_P_cam[0, 0], image_P_cam[1, 1]]).repeat(2)
    return (boxes_px - image_P_cam[:2, 2].repeat(2)) / focal


def ground_line(bottom: Tensor, inverse_depth: Tensor, trust: Tensor) -> GroundLine:
    """The line through the bottoms (N,) of boxes over 1 / depth (N,), as their heights tell it.

    trust (N,): 0 to 1. Reweighted least squares under a prior for a camera on a car, with Cauchy's weights.
    """
    pitch, height = torch.zeros_like(bottom.sum()), torch.full_like(bottom.sum(), _CAMERA_HEIGHT_M)
    a, b, c = pitch, pitch, pitch
    for _ in range(_REWEIGHTINGS):
        variance = (_HEIGHT_SPREAD * height * inverse_depth).square() + _EDGE_SPREAD**2
        off = (bottom - pitch - height * inverse_depth).square() / variance
        weight = trust / (1 + off / 4) / variance
        # The normal equations [[a, b], [b, c]] (pitch, height) = (u, v).
        a = weight.sum() + 1 / _PITCH_SPREAD**2
        b = (weight * inverse_depth).sum()
        c = (weight * inverse_depth.square()).sum() + 1 / _CAMERA_HEIGHT_SPREAD_M**2
        u = (weight * bottom).sum()
        v = (weight * bottom * inverse_depth).sum() + _CAMERA_HEIGHT_M / _CAMERA_HEIGHT_SPREAD_M**2
        determinant = a * c - b * b
        pitch, height = (c * u - b * v) / determinant, (a * v - b * u) / determinant
    return GroundLine(pitch, height, c / determinant, a / determinant)
