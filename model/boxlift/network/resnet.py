"""ResNet-18/34/50 without the last stage and the output layer: what the paper reads its features from.

He et al., "Deep Residual Learning for Image Recognition" (CVPR 2016); in ResNet-50 the stride sits in the
3 x 3 convolution, as in torchvision, whose state dicts load here (their last stage and output are left out).
No weights come with it: without a file it begins at random, which is far from what the paper trained.
"""

from __future__ import annotations

from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch
from torch import Tensor, nn

from boxlift.errors import OptionsError

# Blocks of the first three stages (He et al., table 1); the last stage, of 2, 3 and 3 blocks, is left out.
_BLOCKS = {"resnet18": (2, 2, 2), "resnet34": (3, 4, 6), "resnet50": (3, 4, 6)}
# ImageNet's mean and standard deviation, RGB from 0 to 1: what torchvision's weights were trained with.
_MEAN = (0.485, 0.456, 0.406)
_STD = (0.229, 0.224, 0.225)


class _Basic(nn.Module):
    """Two 3 x 3 convolutions."""

    expansion = 1

    def __init__(self, inputs: int, width: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, width, 3, stride, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.conv2 = nn.Conv2d(width, width, 3, 1, 1, bias=False)
        self.bn2 = nn.BatchNorm2d(width)
        self.downsample = _shortcut(inputs, width, stride)
        self.relu = nn.ReLU(inplace=True)

    def forward(self, features: Tensor) -> Tensor:
        inner: Tensor = self.relu(self.bn1(self.conv1(features)))
        inner = self.bn2(self.conv2(inner))
        joined: Tensor = self.relu(inner + self.downsample(features))
        return joined


class _Bottleneck(nn.Module):
    """1 x 1 down, 3 x 3, 1 x 1 up to four times the width."""

    expansion = 4

    def __init__(self, inputs: int, width: int, stride: int) -> None:
        super().__init__()
        outputs = self.expansion * width
        self.conv1 = nn.Conv2d(inputs, width, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.conv2 = nn.Conv2d(width, width, 3, stride, 1, bias=False)
        self.bn2 = nn.BatchNorm2d(width)
        self.conv3 = nn.Conv2d(width, outputs, 1, bias=False)
        self.bn3 = nn.BatchNorm2d(outputs)
        self.downsample = _shortcut(inputs, outputs, stride)
        self.relu = nn.ReLU(inplace=True)

    def forward(self, features: Tensor) -> Tensor:
        inner: Tensor = self.relu(self.bn1(self.conv1(features)))
        inner = self.relu(self.bn2(self.conv2(inner)))
        inner = self.bn3(self.conv3(inner))
        joined: Tensor = self.relu(inner + self.downsample(features))
        return joined


def _shortcut(inputs: int, outputs: int, stride: int) -> nn.Module:
    if inputs == outputs and stride == 1:
        return nn.Identity()
    return nn.Sequential(nn.Conv2d(inputs, outputs, 1, stride, bias=False), nn.BatchNorm2d(outputs))


class ResNet(nn.Module):
    """Pixels -> feature maps at strides 8 and 16. `channels` says how many each has."""

    strides = (8, 16)

    def __init__(self, name: str) -> None:
        super().__init__()
        block: Any = _Bottleneck if name == "resnet50" else _Basic
        self.conv1 = nn.Conv2d(3, 64, 7, 2, 3, bias=False)
        self.bn1 = nn.BatchNorm2d(64)
        self.relu = nn.ReLU(inplace=True)
        self.maxpool = nn.MaxPool2d(3, 2, 1)
        first, second, third = _BLOCKS[name]
        self.layer1 = _stage(block, 64, 64, first, stride=1)
        self.layer2 = _stage(block, 64 * block.expansion, 128, second, stride=2)
        self.layer3 = _stage(block, 128 * block.expansion, 256, third, stride=2)
        self.channels = (128 * block.expansion, 256 * block.expansion)
        self.mean: Tensor
        self.std: Tensor
        self.register_buffer("mean", torch.tensor(_MEAN).view(1, 3, 1, 1) * 255, persistent=False)
        self.register_buffer("std", torch.tensor(_STD).view(1, 3, 1, 1) * 255, persistent=False)
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")

    def forward(self, image_rgb: Tensor) -> tuple[Tensor, ...]:
        """(B, 3, H, W) RGB, 0 to 255, sides multiples of 16 -> maps (B, channels, H / s, W / s)."""
        features = self.relu(self.bn1(self.conv1((image_rgb - self.mean) / self.std)))
        features = self.layer1(self.maxpool(features))
        fine = self.layer2(features)
        return fine, self.layer3(fine)


def _stage(block: Any, inputs: int, width: int, blocks: int, stride: int) -> nn.Sequential:
    rest = (block(width * block.expansion, width, 1) for _ in range(blocks - 1))
    return nn.Sequential(block(inputs, width, stride), *rest)


def load_weights(model: nn.Module, path: Path, leave_out: tuple[str, ...] = ()) -> None:
    """Load a state dict from a file; entries that begin with one of `leave_out` are not wanted.

    Raises OptionsError where the file is no state dict, or one of another network.
    """
    try:
        states = torch.load(path, map_location="cpu", weights_only=True)
        model.load_state_dict({key: value for key, value in states.items() if not key.startswith(leave_out)})
    except (OSError, EOFError, RuntimeError, UnpicklingError, AttributeError, TypeError) as error:
        raise OptionsError(
            "model.weights",
            f"{str(path)!r} holds no weights of this backbone ({' '.join(str(error).split())!s:.200}).",
            "Give a state dict that torch.save wrote, with torchvision's names for a ResNet.",
        ) from None


# What torchvision's state dicts have beyond the three stages.
BEYOND_THE_STAGES = ("layer4.", "fc.")
