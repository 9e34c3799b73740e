"""RoIAlign in plain torch, for any number of boxes, that exports to ONNX.

After He et al., "Mask R-CNN" (ICCV 2017), with half-pixel offsets (`aligned=True` elsewhere). One difference:
a sample outside the map takes the value at its border, however far outside it lies; others have zeros there.
"""

from __future__ import annotations

import torch
from torch import Tensor


def roi_align(features: Tensor, boxes_px: Tensor, stride: float, size: int = 7, samples: int = 2) -> Tensor:
    """Features (1, C, H, W) of one image under its boxes (N, 4) -> (N, C, size, size).

    boxes_px: x1, y1, x2, y2 in pixels of the image, pixel edges at whole numbers, so that cell i of a map of
    this stride covers the pixels [i * stride, (i + 1) * stride). N may be 0. Every output cell is the mean of
    `samples` x `samples` bilinear samples. All boxes share one sampling of one map: memory goes with N * C.
    """
    channels, height, width = features.shape[1], features.shape[2], features.shape[3]
    steps = (torch.arange(size * samples, dtype=boxes_px.dtype, device=boxes_px.device) + 0.5) / (
        size * samples
    )
    x1, y1, x2, y2 = boxes_px.unbind(1)
    left, right, to_right = _neighbours(x1[:, None] + (x2 - x1)[:, None] * steps, stride, width)
    upper, lower, to_lower = _neighbours(y1[:, None] + (y2 - y1)[:, None] * steps, stride, height)
    # Cells as rows: what a sample needs of all channels then lies together (a GridSample jumps for each).
    cells = features[0].flatten(1).transpose(0, 1)
    sampled = [
        cells[(rows[:, :, None] * width + columns[:, None, :]).flatten()].reshape(
            -1, size * samples, size * samples, channels
        )
        for rows in (upper, lower)
        for columns in (left, right)
    ]
    across, down = to_right[:, None, :, None], to_lower[:, :, None, None]
    above = sampled[0] + (sampled[1] - sampled[0]) * across
    below = sampled[2] + (sampled[3] - sampled[2]) * across
    blended = above + (below - above) * down
    # The number of boxes is left to be found: a pooling layer would refuse to pool no boxes.
    pooled = blended.reshape(-1, size, samples, size, samples, channels).mean(dim=(2, 4))
    return pooled.permute(0, 3, 1, 2)


def _neighbours(position_px: Tensor, stride: float, cells: int) -> tuple[Tensor, Tensor, Tensor]:
    """Of positions the cells before and after, and how far they are from the one to the other (0 to 1)."""
    place = (position_px / stride - 0.5).clamp(0, cells - 1)
    before = place.floor()
    after = (before + 1).clamp(max=cells - 1)
    return before.long(), after.long(), place - before
