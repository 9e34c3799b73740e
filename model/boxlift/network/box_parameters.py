"""What a network says of an object, and the 3D box that this makes."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from boxlift.network.orientation import decode_alpha, facing_away, ray_angle

# No object that an image shows is nearer or farther (ours); it keeps the exponential of a wild output finite.
_NEAREST_M, _FARTHEST_M = 1.0, 150.0
# Sizes are learned within a factor of 2 of the frozen ones.
_LARGEST_LOG_SIZE = 0.7


class BoxParameters(NamedTuple):
    """N objects (paper, sections 3.1 and 3.4).

    center_px (N, 2): the projected centre of the box. depth_m (N,): of the centre along the optical axis.
    orientation (N, bins, 3): see orientation.py. log_size (N, 3): length, width, height over the frozen
    ones; 0 where sizes are frozen.
    """

    center_px: Tensor
    depth_m: Tensor
    orientation: Tensor
    log_size: Tensor


class BoxTensors(NamedTuple):
    """N boxes, rectified camera frame.

    center_cam (N, 3) m; size_m (N, 3) length, width, height; rotation_y (N,) in [-pi, 0).
    """

    center_cam: Tensor
    size_m: Tensor
    rotation_y: Tensor


def to_boxes(parameters: BoxParameters, image_P_cam: Tensor, frozen_size_m: Tensor) -> BoxTensors:
    """The boxes of N objects. image_P_cam (N, 3, 4) or (3, 4); frozen_size_m (N, 3) of their classes."""
    center_cam = back_project(parameters.center_px, parameters.depth_m, image_P_cam)
    rotation_y = facing_away(decode_alpha(parameters.orientation) + ray_angle(center_cam))
    return BoxTensors(center_cam, frozen_size_m * torch.exp(parameters.log_size), rotation_y)


def back_project(pixels: Tensor, depth_m: Tensor, image_P_cam: Tensor) -> Tensor:
    """Pixels (N, 2) at depth (N,) -> (N, 3) in the rectified camera frame (paper, section 3.2).

    The projection has no skew and its third row begins 0 0 1, as a rectified camera's does. Depth is that
    of Calibration.project: the third row applied to the point.
    """
    P = image_P_cam
    z = depth_m - P[..., 2, 3]
    x = (pixels[:, 0] * depth_m - P[..., 0, 2] * z - P[..., 0, 3]) / P[..., 0, 0]
    y = (pixels[:, 1] * depth_m - P[..., 1, 2] * z - P[..., 1, 3]) / P[..., 1, 1]
    return torch.stack([x, y, z], dim=-1)


def project(points_cam: Tensor, image_P_cam: Tensor) -> tuple[Tensor, Tensor]:
    """Points (N, 3) in front of the camera -> pixels (N, 2) and depth (N,)."""
    image = (image_P_cam[..., :, :3] @ points_cam[..., None])[..., 0] + image_P_cam[..., :, 3]
    return image[:, :2] / image[:, 2:], image[:, 2]


def depth_of(log_depth: Tensor) -> Tensor:
    """The head's output, logarithm of metres -> metres, within what an image can show."""
    return log_depth.clamp(math.log(_NEAREST_M), math.log(_FARTHEST_M)).exp()


def log_size_of(output: Tensor) -> Tensor:
    """The head's output -> log_size, bounded."""
    return torch.tanh(output) * _LARGEST_LOG_SIZE
