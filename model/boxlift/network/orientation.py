"""The local orientation as a choice among bins and a turn within them (MultiBin).

After Mousavian et al., "3D Bounding Box Estimation Using Deep Learning and Geometry" (Deep3DBox, CVPR 2017).
The period is pi, half a turn: LiDAR points do not tell front from back, so neither do the targets. All bins
and residuals are those of the doubled angle, whose period is a whole turn.

`alpha` is the observation angle: rotation_y less the direction atan2(x, z) of the ray to the box's centre.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional

# A bin's logit, and cosine and sine of the (doubled) angle from its middle.
NUMBERS_PER_BIN = 3

_SMALLEST_NORM = 1e-6


def decode_alpha(orientation: Tensor) -> Tensor:
    """(N, bins, 3) as the head gives it -> alpha (N,) in [-pi/2, pi/2)."""
    middles = bin_middles(orientation)
    turns = middles + torch.atan2(orientation[..., 2], orientation[..., 1])
    chosen = orientation[..., 0].argmax(dim=-1, keepdim=True)
    return _wrapped(turns.gather(1, chosen).squeeze(1)) / 2


def orientation_loss(orientation: Tensor, alpha: Tensor, overlap: float) -> Tensor:
    """(N,) cross entropy of the bin, and 1 - cos of the doubled angle's error in the bins that cover it.

    alpha (N,): the target, any multiple of pi added. overlap: how far a bin reaches into its neighbours.
    """
    doubled = 2 * alpha[:, None]
    bins = orientation.shape[1]
    from_middle = _wrapped(doubled - bin_middles(orientation))
    nearest = from_middle.abs().argmin(dim=-1)
    covers = (from_middle.abs() <= math.pi / bins * (1 + overlap)).to(orientation.dtype)
    direction = functional.normalize(orientation[..., 1:], dim=-1, eps=_SMALLEST_NORM)
    miss = 1 - direction[..., 0] * torch.cos(from_middle) - direction[..., 1] * torch.sin(from_middle)
    return functional.cross_entropy(orientation[..., 0], nearest, reduction="none") + (miss * covers).sum(
        -1
    ) / covers.sum(-1).clamp(min=1)


def bin_middles(orientation: Tensor) -> Tensor:
    """(bins,) middles of the bins, doubled angles."""
    bins = orientation.shape[1]
    numbers = torch.arange(bins, dtype=orientation.dtype, device=orientation.device)
    return (numbers + 0.5) * (2 * math.pi / bins) - math.pi


def ray_angle(center_cam: Tensor) -> Tensor:
    """(N,) direction of the ray to centres (N, 3), about y: what is between alpha and rotation_y."""
    return torch.atan2(center_cam[:, 0], center_cam[:, 2])


def facing_away(rotation_y: Tensor) -> Tensor:
    """Of the two headings that are half a turn apart, the one in [-pi, 0): as the labeller chooses."""
    return rotation_y - math.pi * (torch.floor(rotation_y / math.pi) + 1)


def _wrapped(angle_rad: Tensor) -> Tensor:
    return angle_rad - 2 * math.pi * torch.floor((angle_rad + math.pi) / (2 * math.pi))
