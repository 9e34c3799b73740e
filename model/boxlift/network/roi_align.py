"""RoIAlign in plain torch, for any number of boxes, that exports to ONNX (GridSample, opset 18 and up).

After He et al., "Mask R-CNN" (ICCV 2017), with half-pixel offsets (`aligned=True` elsewhere). One difference:
a sample outside the map takes the value at its border, however far outside it lies; others have zeros there.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional


def roi_align(features: Tensor, boxes_px: Tensor, stride: float, size: int = 7, samples: int = 2) -> Tensor:
    """Features (1, C, H, W) of one image under its boxes (N, 4) -> (N, C, size, size).

    boxes_px: x1, y1, x2, y2 in pixels of the image, pixel edges at whole numbers, so that cell i of a map of
    this stride covers the pixels [i * stride, (i + 1) * stride). N may be 0. Every output cell is the mean of
    `samples` x `samples` bilinear samples. All boxes share one sampling of one map: memory goes with N * C.
    """
    height, width = features.shape[2], features.shape[3]
    steps = (torch.arange(size * samples, dtype=boxes_px.dtype, device=boxes_px.device) + 0.5) / (
        size * samples
    )
    x1, y1, x2, y2 = boxes_px.unbind(1)
    # grid_sample counts from -1 at one edge of the map to 1 at the other.
    x = (x1[:, None] + (x2 - x1)[:, None] * steps) * (2 / (stride * width)) - 1
    y = (y1[:, None] + (y2 - y1)[:, None] * steps) * (2 / (stride * height)) - 1
    across = x[:, None, :].expand(-1, size * samples, -1)
    down = y[:, :, None].expand(-1, -1, size * samples)
    grid = torch.stack([across, down], dim=-1).flatten(0, 1)[None].to(features.dtype)
    sampled = functional.grid_sample(
        features, grid, mode="bilinear", padding_mode="border", align_corners=False
    )
    # The number of boxes is left to be found: a pooling layer would refuse to pool no boxes.
    cells = sampled.reshape(features.shape[1], -1, size, samples, size, samples)
    return cells.mean(dim=(3, 5)).transpose(0, 1)
