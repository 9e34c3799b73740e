"""A one-stage network in the manner of CenterNet: no 2D boxes, objects are peaks of a heat map.

After Zhou et al., "Objects as Points" (2019), which the paper applies its losses to (table "Comparisons on
CenterNet"). Maps at stride 8 from any backbone; widths are ours, and so is a heat whose spread follows the
2D box on both axes, after Liu et al., "Training-Time-Friendly Network" (AAAI 2020).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from boxlift.network.backbones import Backbone
from boxlift.network.batch import FrameBatch, Images
from boxlift.network.box_parameters import BoxParameters, depth_of, log_size_of
from boxlift.network.config import ModelSettings
from boxlift.network.orientation import NUMBERS_PER_BIN
from boxlift.network.paper_head import TYPICAL_DEPTH_M, start_unturned

STRIDE = 8
PEAKS = 50
# Objects as Points: the bias that gives every cell a heat of .1 at first; alpha and beta of its focal loss.
_FIRST_HEAT_BIAS = -2.19
_FOCAL_ALPHA, _FOCAL_BETA = 2, 4
# Training-Time-Friendly Network: the heat's standard deviation is alpha / 6 of the box, alpha = .54.
_SPREAD = 0.54 / 6


class DenseMaps(NamedTuple):
    """Of every cell of B images.

    heat (B, classes, h, w) logits. extent (B, 2, h, w): width and height of the 2D box; to_middle and
    to_center (B, 2, h, w): from the cell's middle to that of the 2D box, and to the projected centre of the
    3D box; all in cells. depth (B, 1, h, w) logarithm of metres; orientation (B, bins * 3, h, w);
    log_size (B, 3, h, w) as the head gives it, or none.
    """

    heat: Tensor
    extent: Tensor
    to_middle: Tensor
    to_center: Tensor
    depth: Tensor
    orientation: Tensor
    log_size: Tensor | None


class Peaks(NamedTuple):
    """The PEAKS hottest cells of one image: score and category (PEAKS,), boxes_px (PEAKS, 4), parameters."""

    score: Tensor
    category: Tensor
    boxes_px: Tensor
    parameters: BoxParameters


class CenterNetwork(nn.Module):
    """Images -> DenseMaps."""

    def __init__(self, settings: ModelSettings, classes: int) -> None:
        super().__init__()
        self.backbone = Backbone(settings.backbone, settings.weights, frozen=settings.freeze_backbone)
        fine, coarse = self.backbone.channels
        width = settings.hidden
        self.fine = nn.Conv2d(fine, width, 1)
        self.coarse = nn.Conv2d(coarse, width, 1)
        self.join = nn.Sequential(
            nn.ReLU(inplace=True), nn.Conv2d(width, width, 3, padding=1), nn.ReLU(inplace=True)
        )
        self.bins = settings.orientation_bins
        self.heat = _branch(width, classes)
        self.extent = _branch(width, 2)
        self.to_middle = _branch(width, 2)
        self.to_center = _branch(width, 2)
        self.depth = _branch(width, 1)
        self.orientation = _branch(width, self.bins * NUMBERS_PER_BIN)
        self.size = _branch(width, 3) if settings.sizes == "learned" else None
        nn.init.constant_(self.heat[-1].get_parameter("bias"), _FIRST_HEAT_BIAS)
        nn.init.constant_(self.depth[-1].get_parameter("bias"), math.log(TYPICAL_DEPTH_M))
        start_unturned(self.orientation[-1])

    def forward(self, images: Images) -> DenseMaps:
        """Images with sides that are multiples of 32, or maps of a frozen backbone."""
        fine, coarse = self.backbone(images)
        up = functional.interpolate(self.coarse(coarse), scale_factor=2.0, mode="nearest")
        features = self.join(self.fine(fine) + up)
        return DenseMaps(
            heat=self.heat(features).float(),
            extent=self.extent(features).float(),
            to_middle=self.to_middle(features).float(),
            to_center=self.to_center(features).float(),
            depth=self.depth(features).float(),
            orientation=self.orientation(features).float(),
            log_size=None if self.size is None else self.size(features).float(),
        )


def parameters_at(maps: DenseMaps, frame: Tensor, row: Tensor, column: Tensor) -> BoxParameters:
    """What the maps say at the cells (N,) of the images `frame` (N,)."""
    cell = torch.stack([column, row], dim=-1).to(maps.depth.dtype) + 0.5
    orientation = _at(maps.orientation, frame, row, column)
    no_size = torch.zeros_like(orientation[:, :3])
    return BoxParameters(
        center_px=(cell + _at(maps.to_center, frame, row, column)) * STRIDE,
        depth_m=depth_of(_at(maps.depth, frame, row, column)[:, 0]),
        orientation=orientation.reshape(len(row), -1, NUMBERS_PER_BIN),
        log_size=no_size if maps.log_size is None else log_size_of(_at(maps.log_size, frame, row, column)),
    )


def boxes_px_at(maps: DenseMaps, frame: Tensor, row: Tensor, column: Tensor) -> Tensor:
    """(N, 4) 2D boxes that the maps say at the cells."""
    cell = torch.stack([column, row], dim=-1).to(maps.extent.dtype) + 0.5
    middle = cell + _at(maps.to_middle, frame, row, column)
    half = _at(maps.extent, frame, row, column).clamp(min=0) / 2
    return torch.cat([middle - half, middle + half], dim=-1) * STRIDE


def find_peaks(maps: DenseMaps) -> Peaks:
    """The objects of the first image: cells that are the hottest among their eight neighbours."""
    heat = maps.heat[:1].sigmoid()
    is_peak = functional.max_pool2d(heat, 3, 1, 1) == heat
    height, width = heat.shape[2:]
    score, index = torch.where(is_peak, heat, 0.0).flatten().topk(min(PEAKS, heat.numel()))
    # Looked up rather than divided out: sizes are not known when this is exported.
    classes = heat.shape[1]
    category, row, column = (
        torch.arange(length, device=heat.device).view(shape).expand(classes, height, width).flatten()[index]
        for length, shape in ((classes, (-1, 1, 1)), (height, (1, -1, 1)), (width, (1, 1, -1)))
    )
    frame = torch.zeros_like(row)
    return Peaks(
        score=score,
        category=category,
        boxes_px=boxes_px_at(maps, frame, row, column),
        parameters=parameters_at(maps, frame, row, column),
    )


def object_cells(batch: FrameBatch, maps: DenseMaps) -> tuple[Tensor, Tensor, Tensor]:
    """(N,) image, row and column of the cell under the middle of every object's 2D box."""
    boxes_px = batch.objects.boxes_px
    height, width = maps.heat.shape[2:]
    middle = ((boxes_px[:, :2] + boxes_px[:, 2:]) / (2 * STRIDE)).floor().long()
    counts = torch.tensor(batch.object_counts, device=boxes_px.device)
    frame = torch.arange(len(counts), device=boxes_px.device).repeat_interleave(counts)
    return frame, middle[:, 1].clamp(0, height - 1), middle[:, 0].clamp(0, width - 1)


def detection_loss(maps: DenseMaps, batch: FrameBatch, extent_weight: float) -> dict[str, Tensor]:
    """Heat by a focal loss per object, 2D boxes by L1 (Objects as Points, equations 1 to 4)."""
    frame, row, column = object_cells(batch, maps)
    objects = max(1, len(row))
    target = target_heat(batch, maps)
    heat = maps.heat
    hit = target == 1
    # log(sigmoid) of plus and minus the logit are safe where log(heat) and log(1 - heat) are not.
    positive = functional.logsigmoid(heat) * (1 - heat.sigmoid()) ** _FOCAL_ALPHA
    negative = functional.logsigmoid(-heat) * heat.sigmoid() ** _FOCAL_ALPHA * (1 - target) ** _FOCAL_BETA
    focal = -torch.where(hit, positive, negative).sum() / objects
    boxes = batch.objects.boxes_px / STRIDE
    extent_error = (_at(maps.extent, frame, row, column) - (boxes[:, 2:] - boxes[:, :2])).abs()
    found = boxes_px_at(maps, frame, row, column) / STRIDE
    middle_error = ((found[:, :2] + found[:, 2:]) - (boxes[:, :2] + boxes[:, 2:])).abs() / 2
    return {
        "heat": focal,
        "extent": extent_weight * extent_error.sum() / objects,
        "middle": middle_error.sum() / objects,
    }


def target_heat(batch: FrameBatch, maps: DenseMaps) -> Tensor:
    """(B, classes, h, w) a bell around each object's cell, 1 there; where bells overlap, the higher."""
    frame, row, column = object_cells(batch, maps)
    boxes_px = batch.objects.boxes_px
    spread = ((boxes_px[:, 2:] - boxes_px[:, :2]) / STRIDE * _SPREAD).clamp(min=0.3)
    height, width = maps.heat.shape[2:]
    rows = torch.arange(height, device=boxes_px.device)
    columns = torch.arange(width, device=boxes_px.device)
    down = torch.exp(-((rows - row[:, None]) ** 2) / (2 * spread[:, 1:] ** 2))
    across = torch.exp(-((columns - column[:, None]) ** 2) / (2 * spread[:, :1] ** 2))
    heat = torch.zeros_like(maps.heat)
    bells = down[:, :, None] * across[:, None, :]
    for index in range(len(row)):
        here = heat[frame[index], batch.objects.category[index]]
        torch.maximum(here, bells[index], out=here)
    return heat


def _at(maps: Tensor, frame: Tensor, row: Tensor, column: Tensor) -> Tensor:
    """(N, C) of maps (B, C, h, w)."""
    return maps[frame, :, row, column]


def _branch(width: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(width, width, 3, padding=1), nn.ReLU(inplace=True), nn.Conv2d(width, outputs, 1)
    )
