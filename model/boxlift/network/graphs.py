"""The network as the graphs that are exported: raw pixels in, boxes in pixels and metres out."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from boxlift.network.detections import Detections, RoadUsers
from boxlift.network.nanodet import STRIDES, NanoDetHead, NanoDetTrunk

_MULTIPLE = STRIDES[-1]


class PaddedTrunk(nn.Module):
    """An image of any size -> NanoDet's maps; below and right it is padded with black to multiples of 32."""

    def __init__(self, trunk: NanoDetTrunk) -> None:
        super().__init__()
        self.trunk = trunk

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """image (H, W, 3) uint8 RGB."""
        pixels = image.permute(2, 0, 1)[None].to(torch.float32)
        height, width = image.shape[0], image.shape[1]
        maps: tuple[Tensor, Tensor, Tensor] = self.trunk(
            functional.pad(pixels, (0, -width % _MULTIPLE, 0, -height % _MULTIPLE))
        )
        return maps


class DetectorGraph(nn.Module):
    """A 2D detector after the interface of `boxlift.detector`: image (H, W, 3) uint8 -> `Detections`.

    The head has the classes of COCO_INDICES.
    """

    def __init__(self, trunk: NanoDetTrunk, head: NanoDetHead, min_score: float) -> None:
        super().__init__()
        self.trunk = PaddedTrunk(trunk)
        self.head = head
        self.road_users = RoadUsers(min_score)

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Everything of `Detections`."""
        found: Detections = self.road_users(self.head(self.trunk(image)), *image_size(image))
        return found.boxes_px, found.scores, found.categories


def image_size(image: Tensor) -> tuple[Tensor, Tensor]:
    """Width and height as float tensors, so that an exported graph reads them from its input."""
    height, width = image.shape[0], image.shape[1]
    return torch.scalar_tensor(width), torch.scalar_tensor(height)
