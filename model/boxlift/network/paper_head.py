"""The paper's network: an encoder, RoI features of each 2D box, fully connected layers for each output.

Appendix "Network and Running Time": 7 x 7 RoI-aligned features, flattened, "passing fully connected layers to
regress corresponding outputs". Widths and how outputs are scaled are ours.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from boxlift.network.backbones import STRIDES, Backbone
from boxlift.network.batch import Images
from boxlift.network.box_parameters import BoxParameters, depth_of, log_size_of
from boxlift.network.config import ModelSettings
from boxlift.network.orientation import NUMBERS_PER_BIN
from boxlift.network.roi_align import roi_align

ROI_SIZE = 7
# Where training begins: the middle of what cars on a street are seen at (ours).
TYPICAL_DEPTH_M = 20.0


class PaperNetwork(nn.Module):
    """Images, their projections and 2D boxes -> BoxParameters of all boxes."""

    def __init__(self, settings: ModelSettings) -> None:
        super().__init__()
        self.backbone = Backbone(settings.backbone, settings.weights, frozen=settings.freeze_backbone)
        self.roi_strides = settings.roi_strides
        channels = sum(self.backbone.channels[STRIDES.index(stride)] for stride in settings.roi_strides)
        self.head = PaperHead(channels, settings)
        # Of the frames that it is trained on: the focal length at which it knows the world.
        self.register_buffer("focal_px", torch.tensor(0.0))
        self.focal_px: Tensor

    def forward(
        self, images: Images, image_P_cam: Tensor, boxes_px: list[Tensor], frozen_size_m: list[Tensor]
    ) -> BoxParameters:
        """images (or maps); image_P_cam (B, 3, 4); per image boxes_px (N, 4) and size (N, 3)

        of each box's class (length, width, height). The boxes come out in the order of the images.
        """
        maps = dict(zip(STRIDES, self.backbone(images), strict=True))
        found = []
        for index, (boxes, sizes) in enumerate(zip(boxes_px, frozen_size_m, strict=True)):
            features = [
                roi_align(maps[stride][index : index + 1], boxes, stride, ROI_SIZE)
                for stride in self.roi_strides
            ]
            found.append(self.head(torch.cat(features, 1), boxes, sizes[:, 2], image_P_cam[index, 1, 1]))
        return BoxParameters(*(torch.cat(columns) for columns in zip(*found, strict=True)))


class PaperHead(nn.Module):
    """RoI features (N, C, 7, 7) -> BoxParameters."""

    def __init__(self, channels: int, settings: ModelSettings) -> None:
        super().__init__()
        features = channels * ROI_SIZE**2
        self.depth_from = settings.depth
        self.bins = settings.orientation_bins
        self.center = _fully_connected(features, settings.hidden, 2)
        self.depth = _fully_connected(features, settings.hidden, 1)
        self.orientation = _fully_connected(features, settings.hidden, self.bins * NUMBERS_PER_BIN)
        start_unturned(self.orientation[-1])
        learned = settings.sizes == "learned"
        self.size = _fully_connected(features, settings.hidden, 3) if learned else None

    def forward(
        self, rois: Tensor, boxes_px: Tensor, frozen_height_m: Tensor, focal_px: Tensor
    ) -> BoxParameters:
        """frozen_height_m (N,) and focal_px (scalar, vertical) serve depth from the box's height."""
        flat = rois.flatten(1)
        extent_px = (boxes_px[:, 2:] - boxes_px[:, :2]).clamp(min=1)
        middle_px = (boxes_px[:, :2] + boxes_px[:, 2:]) / 2
        log_depth = self.depth(flat)[:, 0].float()
        if self.depth_from == "box_height":
            log_depth = log_depth + (focal_px * frozen_height_m / extent_px[:, 1]).log()
        else:
            log_depth = log_depth + math.log(TYPICAL_DEPTH_M)
        orientation = self.orientation(flat).float().unflatten(1, (self.bins, NUMBERS_PER_BIN))
        no_size = torch.zeros_like(boxes_px[:, :3])
        return BoxParameters(
            center_px=middle_px + self.center(flat).float() * extent_px,
            depth_m=depth_of(log_depth),
            orientation=orientation,
            log_size=no_size if self.size is None else log_size_of(self.size(flat).float()),
        )


def start_unturned(layer: nn.Module) -> None:
    """Let the last layer of an orientation begin in the middle of every bin: cosine 1, sine 0."""
    with torch.no_grad():
        layer.get_parameter("bias")[1::NUMBERS_PER_BIN] = 1


def _fully_connected(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    last = nn.Linear(hidden, outputs)
    # Begin near the middle of the box, the typical depth and no turn from the bin's middle.
    nn.init.normal_(last.weight, std=1e-3)
    nn.init.zeros_(last.bias)
    return nn.Sequential(nn.Linear(inputs, hidden), nn.ReLU(inplace=True), last)
