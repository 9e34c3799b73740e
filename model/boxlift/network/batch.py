"""What a training step sees: images of one size, and the objects of all of them one after the other."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

# (B, 3, H, W) RGB from 0 to 255, or the maps that a frozen backbone made of them.
Images = Tensor | tuple[Tensor, ...]


@dataclass(frozen=True)
class ObjectBatch:
    """N objects with what supervises them.

    boxes_px (N, 4); category (N,) index into the training's classes; frozen_size_m (N, 3) length, width,
    height of the class.
    weight (N,): of the object in the losses on its 3D box, 0 where nothing supervises that (the columns below
    then hold any finite numbers).

    From LiDAR: points_cam (N, M, 3) and is_point (N, M) bool, False where padded; heading (N,) rotation_y,
    modulo pi; origin_xz (N, 2) where the rays of the ray tracing loss start.
    From a box: center_cam (N, 3), size_m (N, 3), rotation_y (N,).
    """

    boxes_px: Tensor
    category: Tensor
    frozen_size_m: Tensor
    weight: Tensor
    points_cam: Tensor
    is_point: Tensor
    heading: Tensor
    origin_xz: Tensor
    center_cam: Tensor
    size_m: Tensor
    rotation_y: Tensor


@dataclass(frozen=True)
class FrameBatch:
    """B frames: images padded below and right, or maps of them; image_P_cam (B, 3, 4).

    object_counts: how many of the objects belong to each frame, in their order.
    """

    images: Images
    image_P_cam: Tensor
    object_counts: list[int]
    objects: ObjectBatch

    def split(self, column: Tensor) -> list[Tensor]:
        """A column of the objects, frame by frame."""
        return list(torch.split(column, self.object_counts))

    def projections(self) -> Tensor:
        """(N, 3, 4) the projection of every object's image."""
        counts = torch.tensor(self.object_counts, device=self.image_P_cam.device)
        return self.image_P_cam.repeat_interleave(counts, dim=0)
