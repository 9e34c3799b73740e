"""Backbones behind one interface: pixels in, maps at strides 8 and 16 out."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from torch import Tensor, nn

from boxlift.detector import DEFAULT_FILE
from boxlift.network import onnx_files
from boxlift.network.batch import Images
from boxlift.network.nanodet import NECK_CHANNELS, NanoDetTrunk
from boxlift.network.resnet import BEYOND_THE_STAGES, ResNet, load_weights

BackboneName = Literal["resnet18", "resnet34", "resnet50", "nanodet"]
STRIDES = (8, 16)
# Images are padded to this, below and right.
MULTIPLE = 32


class Backbone(nn.Module):
    """(B, 3, H, W) RGB from 0 to 255, sides multiples of MULTIPLE -> a map per stride of STRIDES.

    channels: of each map. Frozen, it stays in evaluation mode and has no gradient.
    """

    def __init__(self, name: BackboneName, weights: Path | None = None, *, frozen: bool = False) -> None:
        """`weights`: a state dict. Without one NanoDet has those of the detector that comes with boxlift

        (COCO), and a ResNet is random. Raises OptionsError for a file that holds none of this backbone.
        """
        super().__init__()
        self.body: ResNet | NanoDetTrunk
        if name == "nanodet":
            self.body = NanoDetTrunk()
            self.channels: tuple[int, ...] = (NECK_CHANNELS, NECK_CHANNELS)
        else:
            self.body = ResNet(name)
            self.channels = self.body.channels
        if weights is not None:
            load_weights(self.body, weights, BEYOND_THE_STAGES)
        elif name == "nanodet":
            onnx_files.load_weights(self.body, onnx_files.read_weights(DEFAULT_FILE), "trunk.trunk.")
        self.frozen = frozen
        if frozen:
            self.requires_grad_(False)

    def train(self, mode: bool = True) -> Backbone:
        """As torch's, but statistics of a frozen backbone stay as they are."""
        super().train(mode and not self.frozen)
        return self

    def forward(self, image_rgb: Images) -> tuple[Tensor, ...]:
        """Images to maps; what are maps already, of this backbone when frozen, stays."""
        if isinstance(image_rgb, tuple):
            return image_rgb
        maps: tuple[Tensor, ...] = self.body(image_rgb)
        return maps[: len(STRIDES)]
