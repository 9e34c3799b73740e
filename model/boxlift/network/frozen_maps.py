"""Maps of a frozen backbone, made once per frame and kept in memory (5 MB for one of KITTI's by NanoDet)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

from boxlift.network.backbones import MULTIPLE, Backbone
from boxlift.network.training_frames import TrainingFrame

# The maps of an image by its path.
KnownMaps = dict[Path, tuple[Tensor, ...]]


class FrozenMaps:
    """Maps of frames by one backbone. `known`: those that it made before, to which new ones are added."""

    def __init__(self, backbone: Backbone, known: KnownMaps) -> None:
        self._backbone = backbone
        self._known = known

    def of(self, frames: Sequence[TrainingFrame]) -> tuple[Tensor, ...]:
        """The maps (B, C, h, w) of frames on the CPU, zeros below and right of the smaller ones."""
        for frame in frames:
            if frame.image_path not in self._known:
                self._known[frame.image_path] = self._maps(frame)
        levels = zip(*(self._known[frame.image_path] for frame in frames), strict=True)
        return tuple(_stacked(level) for level in levels)

    @torch.no_grad()
    def _maps(self, frame: TrainingFrame) -> tuple[Tensor, ...]:
        pixels = torch.from_numpy(frame.read_image()).permute(2, 0, 1)[None]
        height, width = pixels.shape[2:]
        padded = torch.zeros(1, 3, height + -height % MULTIPLE, width + -width % MULTIPLE)
        padded[..., :height, :width] = pixels
        device = next(self._backbone.parameters()).device
        return tuple(level[0].cpu() for level in self._backbone.eval()(padded.to(device)))


def _stacked(maps: Sequence[Tensor]) -> Tensor:
    height, width = (max(each.shape[axis] for each in maps) for axis in (1, 2))
    stacked = maps[0].new_zeros(len(maps), maps[0].shape[0], height, width)
    for place, each in zip(stacked, maps, strict=True):
        place[:, : each.shape[1], : each.shape[2]] = each
    return stacked
