"""NanoDet-g in torch: the trunk whose features the monocular network reads, and its 2D detections.

After NanoDet (RangiLyu, Apache-2.0), configuration nanodet-g: a CSP trunk, a path aggregation neck and one
head per level; batch normalisation is folded into the convolutions. Every convolution carries the name that
`scripts/convert_nanodet.py` gives its weights.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

STRIDES = (8, 16, 32)
NECK_CHANNELS = 128
# The sides of a box are expectations over this many bins (Generalized Focal Loss, Li et al., 2020).
SIDE_BINS = 11
COCO_CLASSES = 80

_SLOPE = 0.1
# Of the pixels 0 to 255 in the order blue, green, red: NanoDet's configuration.
_MEAN_BGR = (103.53, 116.28, 123.675)
_STD_BGR = (57.375, 57.12, 58.395)


class _Conv(nn.Conv2d):
    """3 x 3 (or other) convolution with `same` padding and a leaky rectifier."""

    def __init__(self, inputs: int, outputs: int, kernel: int = 3, stride: int = 1) -> None:
        super().__init__(inputs, outputs, kernel, stride, padding=kernel // 2)

    def forward(self, input: Tensor) -> Tensor:  # noqa: A002 - as torch calls it
        return functional.leaky_relu(super().forward(input), _SLOPE)


class CspBlock(nn.Module):
    """Halves, splits and joins: `width` channels inside, twice as many out."""

    def __init__(self, inputs: int, width: int, depth: int, stride: int) -> None:
        super().__init__()
        self.enter = _Conv(inputs, width, stride=stride)
        self.first = nn.ModuleList(_Conv(width, width // 2) for _ in range(depth))
        self.second = nn.ModuleList(_Conv(width // 2, width // 2) for _ in range(depth))
        self.leave = _Conv(width, width)

    def forward(self, features: Tensor) -> Tensor:
        entered = inner = self.enter(features)
        for first, second in zip(self.first, self.second, strict=True):
            half = first(inner)
            inner = torch.cat([second(half), half], dim=1)
        return torch.cat([self.leave(inner), entered], dim=1)


class NanoDetTrunk(nn.Module):
    """Pixels -> feature maps of 128 channels at strides 8, 16 and 32."""

    mean: Tensor
    std: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.stem = _Conv(3, 32, stride=2)
        self.stages = nn.ModuleList(
            [
                CspBlock(32, 32, 1, 1),
                CspBlock(64, 64, 2, 2),
                CspBlock(128, 128, 2, 2),
                CspBlock(256, 256, 3, 2),
            ]
        )
        self.lateral = nn.ModuleList(nn.Conv2d(channels, NECK_CHANNELS, 1) for channels in (128, 256, 512))
        self.register_buffer("mean", torch.tensor(_MEAN_BGR).view(1, 3, 1, 1), persistent=False)
        self.register_buffer("std", torch.tensor(_STD_BGR).view(1, 3, 1, 1), persistent=False)

    def forward(self, image_rgb: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(B, 3, H, W) RGB, 0 to 255, sides multiples of 32 -> maps (B, 128, H / s, W / s)."""
        normalised = (image_rgb.flip(1) - self.mean) / self.std
        features = functional.max_pool2d(self.stem(normalised), 3, 2, 1)
        levels = []
        for stage in self.stages:
            features = stage(features)
            levels.append(features)
        fine, middle, coarse = (conv(level) for conv, level in zip(self.lateral, levels[1:], strict=True))
        # Down from coarse to fine, and up again. Halving by bilinear interpolation is the mean of four.
        middle = middle + _double(coarse)
        fine = fine + _double(middle)
        middle = middle + functional.avg_pool2d(fine, 2)
        coarse = coarse + functional.avg_pool2d(middle, 2)
        return fine, middle, coarse


def _double(features: Tensor) -> Tensor:
    return functional.interpolate(features, scale_factor=2.0, mode="bilinear", align_corners=False)


class RawDetections(NamedTuple):
    """What NanoDet says of every cell: scores (B, N, classes) and boxes (B, N, 4) as x1, y1, x2, y2 px."""

    scores: Tensor
    boxes_px: Tensor


class NanoDetHead(nn.Module):
    """Feature maps -> scores of `classes` and a box for every cell of every level."""

    def __init__(self, classes: int = COCO_CLASSES) -> None:
        super().__init__()
        self.classes = classes
        self.tower = nn.ModuleList(_Conv(NECK_CHANNELS, NECK_CHANNELS) for _ in STRIDES)
        self.output = nn.ModuleList(nn.Conv2d(NECK_CHANNELS, classes + 4 * SIDE_BINS, 1) for _ in STRIDES)

    def forward(self, levels: tuple[Tensor, Tensor, Tensor]) -> RawDetections:
        """Maps as NanoDetTrunk gives them -> raw detections, fine cells first."""
        scores, boxes = [], []
        for level, tower, output, stride in zip(levels, self.tower, self.output, STRIDES, strict=True):
            maps = output(tower(level)).flatten(2).transpose(1, 2)
            scores.append(maps[..., : self.classes].sigmoid())
            boxes.append(_boxes(maps[..., self.classes :], level, stride))
        return RawDetections(torch.cat(scores, 1), torch.cat(boxes, 1))

    def keep_classes(self, coco_indices: list[int]) -> NanoDetHead:
        """The same head with some of its classes, in this order."""
        kept = NanoDetHead(len(coco_indices))
        rows = [*coco_indices, *range(self.classes, self.classes + 4 * SIDE_BINS)]
        kept.tower.load_state_dict(self.tower.state_dict())
        for ours, all_classes in zip(kept.output, self.output, strict=True):
            ours.load_state_dict({name: value[rows] for name, value in all_classes.state_dict().items()})
        return kept


def _boxes(maps: Tensor, level: Tensor, stride: int) -> Tensor:
    """(B, N, 4 x bins) logits -> (B, N, 4): the sides left, top, right, bottom around each cell's centre."""
    height, width = level.shape[2], level.shape[3]
    bins = torch.arange(SIDE_BINS, dtype=maps.dtype, device=maps.device)
    # As one product of matrices: one for each cell would take longer than many a layer.
    expected = maps.reshape(-1, SIDE_BINS).softmax(-1) @ bins[:, None]
    sides = expected.reshape(*maps.shape[:2], 4) * stride
    x = (torch.arange(width, dtype=maps.dtype, device=maps.device) + 0.5) * stride
    y = (torch.arange(height, dtype=maps.dtype, device=maps.device) + 0.5) * stride
    centers = torch.stack([x.expand(height, width), y[:, None].expand(height, width)], -1).flatten(0, 1)
    return torch.cat([centers - sides[..., :2], centers + sides[..., 2:]], -1)
