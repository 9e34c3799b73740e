"""The network as the graphs that are exported: raw pixels in, boxes in pixels and metres out."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from boxlift.network.detections import Detections, RoadUsers
from boxlift.network.lifter import PROMPT_SCORE, Lifted, Lifter
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


class MonocularGraph(nn.Module):
    """The interface "monocular/1": image, projection and 2D boxes, if any -> boxes in 3D.

    With 2D boxes the detector's own are left out; without (N = 0) they take their place.
    """

    def __init__(self, trunk: NanoDetTrunk, head: NanoDetHead, lifter: Lifter, min_score: float) -> None:
        super().__init__()
        self.trunk = PaddedTrunk(trunk)
        self.head = head
        self.road_users = RoadUsers(min_score)
        self.lifter = lifter

    def forward(
        self, image: Tensor, image_P_cam: Tensor, prompt_boxes_px: Tensor, prompt_categories: Tensor
    ) -> tuple[Tensor, ...]:
        """image (H, W, 3) uint8, (3, 4), (N, 4), (N,) -> the outputs in the order of MONOCULAR_OUTPUTS."""
        maps = self.trunk(image)
        size_px = image_size(image)
        found = self.road_users(self.head(maps), *size_px)
        # Counted and not asked of a shape: an exported graph then looks at every call.
        unprompted = torch.ones_like(prompt_categories).sum() == 0
        kept = (unprompted & (found.scores > 0)).nonzero()[:, 0]
        boxes_px = torch.cat([prompt_boxes_px, found.boxes_px[kept]])
        categories = torch.cat([prompt_categories, found.categories[kept]])
        given = torch.ones_like(prompt_boxes_px[:, 0])
        known = torch.cat([PROMPT_SCORE * given, found.scores[kept]])
        lifted = self.lifter.lift(maps, boxes_px, categories, known, image_P_cam, size_px)
        return boxes_px, categories, torch.cat([given, found.scores[kept]]), *lifted


MONOCULAR_INPUTS = ("image", "image_P_cam", "prompt_boxes_px", "prompt_categories")
MONOCULAR_OUTPUTS = ("boxes_px", "categories", "detection_scores", *Lifted._fields)
