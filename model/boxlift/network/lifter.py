"""The head that ships: small networks, each a voice, that lift 2D boxes to 3D; their mean is the answer.

Some voices hear geometry only and transfer to any camera; the others also see the features of the RoI, and
know a small car that is near from a large one far away. All predict depth as a factor on what geometry says,
with its uncertainty, and whether there is an object of this class at all.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from boxlift.network.geometry import FEATURES, describe, typical_sizes
from boxlift.network.nanodet import NECK_CHANNELS, STRIDES
from boxlift.network.roi_align import roi_align

ROI_SIZE = 7
ROI_CHANNELS = 2 * NECK_CHANNELS
# RoIs reach this far beyond their box: what an object stands on and next to tells of its depth (ours).
_ROI_GROWTH = 1.15
# A detector's score where a user gave the box: what detections of whole cars usually have.
PROMPT_SCORE = 0.5
_SLOPE = 0.1
_GEOMETRY_WIDTH, _JOINT_WIDTH = 48, 64
# Logarithms of the relative depth spread: where it starts, and its range around that.
_TYPICAL_SPREAD = 2.5
_LEAST_SPREAD, _MOST_SPREAD = -3.5, 2.0
# Sizes are learned as a tenth of what a layer gives: they hardly vary.
_SIZE_STEP = 0.1


class Answer(NamedTuple):
    """What one voice says of N objects; leading dimensions are free.

    depth_log (N,): logarithm of depth over that of geometry; spread_log (N,): of its Laplace scale.
    offset (N, 2): of the projected centre from that of the box, in widths and heights. double_angle (N, 2):
    sine and cosine of twice the local orientation, so that its period is pi: LiDAR does not tell front from
    back. size_log (N, 3): logarithm of length, width, height over the typical ones. object_logit (N,).
    """

    depth_log: Tensor
    spread_log: Tensor
    offset: Tensor
    double_angle: Tensor
    size_log: Tensor
    object_logit: Tensor


OUTPUTS = 10


class Voice(nn.Module):
    """Geometry (N, FEATURES) and, where `channels` is not 0, RoIs (N, C, 7, 7) -> raw outputs (N, 10)."""

    def __init__(self, channels: int, width: int, dropout: float) -> None:
        super().__init__()
        self.dropout = dropout
        self.sees = channels > 0
        self.geometry = nn.Linear(FEATURES, _GEOMETRY_WIDTH)
        if self.sees:
            self.reduce = nn.Conv2d(ROI_CHANNELS, channels, 1)
            self.appearance = nn.Linear(channels * ROI_SIZE**2, width)
        self.joint = nn.Linear(_GEOMETRY_WIDTH + (width if self.sees else 0), _JOINT_WIDTH)
        self.output = nn.Linear(_JOINT_WIDTH, OUTPUTS)
        # A new voice agrees with geometry.
        nn.init.normal_(self.output.weight, 0, 0.01)
        nn.init.zeros_(self.output.bias)

    def forward(self, geometry: Tensor, rois: Tensor | None) -> Tensor:
        hidden = functional.leaky_relu(self.geometry(geometry), _SLOPE)
        if self.sees:
            assert rois is not None
            seen = functional.leaky_relu(self.reduce(rois), _SLOPE).flatten(1)
            seen = functional.dropout(seen, self.dropout, self.training)
            hidden = torch.cat([functional.leaky_relu(self.appearance(seen), _SLOPE), hidden], 1)
        hidden = functional.dropout(hidden, self.dropout / 2, self.training)
        raw: Tensor = self.output(functional.leaky_relu(self.joint(hidden), _SLOPE))
        return raw


def answer_of(raw: Tensor) -> Answer:
    """Raw outputs (..., 10) -> their meaning."""
    return Answer(
        depth_log=raw[..., 0],
        spread_log=raw[..., 1].clamp(_LEAST_SPREAD, _MOST_SPREAD) - _TYPICAL_SPREAD,
        offset=raw[..., 2:4],
        double_angle=raw[..., 4:6],
        size_log=raw[..., 6:9] * _SIZE_STEP,
        object_logit=raw[..., 9],
    )


class Lifted(NamedTuple):
    """N boxes in the rectified camera frame, as the interface of monocular models names them.

    scores: probability that a labeller with LiDAR would put a box there, and not on a part of an object or on
    one that has a better 2D box. How far off the box may be is in depth_spread, and not in the score: ranked
    with it, precision on unseen drives fell.
    """

    centers_cam: Tensor
    sizes_m: Tensor
    rotations_y: Tensor
    depth_spread: Tensor
    scores: Tensor


class Lifter(nn.Module):
    """2D boxes and NanoDet's maps -> 3D boxes.

    voices: of which the first `blind` hear geometry only. mean, deviation: of the RoI features, per channel.
    """

    mean: Tensor
    deviation: Tensor
    typical_m: Tensor

    def __init__(
        self,
        blind: int = 4,
        seeing: int = 4,
        channels: int = 16,
        width: int = 96,
        dropout: float = 0.3,
        *,
        learn_sizes: bool = False,
    ) -> None:
        super().__init__()
        self.learn_sizes = learn_sizes
        self.blind = blind
        self.shape = {
            "blind": blind,
            "seeing": seeing,
            "channels": channels,
            "width": width,
            "learn_sizes": learn_sizes,
        }
        self.voices = nn.ModuleList(
            [Voice(0, width, dropout) for _ in range(blind)]
            + [Voice(channels, width, dropout) for _ in range(seeing)]
        )
        self.register_buffer("mean", torch.zeros(1, ROI_CHANNELS, 1, 1))
        self.register_buffer("deviation", torch.ones(1, ROI_CHANNELS, 1, 1))
        self.register_buffer("typical_m", typical_sizes(), persistent=False)

    @property
    def sees(self) -> bool:
        """Whether any voice wants RoI features."""
        return any(voice.sees for voice in self.voices)

    def forward(self, geometry: Tensor, rois: Tensor | None) -> Tensor:
        """Geometry (N, FEATURES) and RoI features (N, C, 7, 7) -> raw outputs (voices, N, 10)."""
        if rois is not None:
            rois = (rois - self.mean) / self.deviation
        return torch.stack([voice(geometry, rois) for voice in self.voices])

    def lift(
        self,
        maps: tuple[Tensor, Tensor, Tensor],
        boxes_px: Tensor,
        categories: Tensor,
        detection_scores: Tensor,
        image_P_cam: Tensor,
        image_size_px: tuple[Tensor, Tensor],
    ) -> Lifted:
        """Maps of one image (1, C, H, W), boxes (N, 4), categories and scores (N,), projection (3, 4)."""
        geometry = describe(boxes_px, categories, detection_scores, image_P_cam, image_size_px)
        rois = rois_of(maps, boxes_px) if self.sees else None
        raw = self(geometry.features, rois)
        return self.decide(raw, boxes_px, categories, geometry.depth_m, image_P_cam)

    def decide(
        self, raw: Tensor, boxes_px: Tensor, categories: Tensor, depth_m: Tensor, image_P_cam: Tensor
    ) -> Lifted:
        """Raw outputs (voices, N, 10) -> boxes."""
        answer = answer_of(raw)
        sizes = self.typical_m.to(raw)[categories]
        if self.learn_sizes:
            sizes = sizes * torch.exp(answer.size_log.mean(0))
        depth = depth_m * torch.exp(answer.depth_log.mean(0))
        # Voices that disagree know less than each believes.
        disagreement = (answer.depth_log - answer.depth_log.mean(0)).square().mean(0).sqrt()
        spread = torch.exp(answer.spread_log).mean(0) + disagreement
        low, high = boxes_px[:, :2], boxes_px[:, 2:]
        center_px = (low + high) / 2 + answer.offset.mean(0) * (high - low)
        centers = back_project(center_px, depth, image_P_cam)
        sine, cosine = answer.double_angle.mean(0).unbind(-1)
        heading = torch.atan2(sine, cosine) / 2 + torch.atan2(centers[:, 0], centers[:, 2])
        # Whether there is an object is seen, not heard: on unseen drives the blind voices only blur it.
        judges = answer.object_logit[self.blind :] if self.sees else answer.object_logit
        real = torch.sigmoid(judges).mean(0)
        # A Laplace distribution of this scale has the square root of 2 as standard deviation.
        return Lifted(centers, sizes, facing_away(heading), math.sqrt(2) * spread, real)


def rois_of(maps: tuple[Tensor, Tensor, Tensor], boxes_px: Tensor) -> Tensor:
    """RoI features (N, ROI_CHANNELS, 7, 7) of boxes (N, 4) from the two finer maps."""
    center = (boxes_px[:, :2] + boxes_px[:, 2:]) / 2
    reach = (boxes_px[:, 2:] - boxes_px[:, :2]) / 2 * _ROI_GROWTH
    grown = torch.cat([center - reach, center + reach], 1)
    return torch.cat([roi_align(maps[level], grown, STRIDES[level], ROI_SIZE) for level in (0, 1)], 1)


def back_project(pixels: Tensor, depth_m: Tensor, image_P_cam: Tensor) -> Tensor:
    """Pixels (N, 2) at depths (N,) -> (N, 3) in the rectified camera frame.

    As `Calibration.back_project`, written out for a projection whose first three columns are an upper
    triangle [[f, s, c], [0, f, c], [0, 0, 1]].
    """
    P = image_P_cam
    z = depth_m - P[2, 3]
    y = (pixels[:, 1] * depth_m - P[1, 3] - P[1, 2] * z) / P[1, 1]
    x = (pixels[:, 0] * depth_m - P[0, 3] - P[0, 2] * z - P[0, 1] * y) / P[0, 0]
    return torch.stack([x, y, z], 1)


def facing_away(rotation_y: Tensor) -> Tensor:
    """Of the two headings that look alike the one away from the camera, in [-pi, 0)."""
    return torch.remainder(rotation_y, math.pi) - math.pi
