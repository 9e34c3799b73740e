"""The paper's losses straight on object-LiDAR-points (equation 6): alignment, y and orientation.

For comparison also plain regression to boxes: pseudo labels, or drawn ones.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from boxlift.losses import BevBoxes, balanced_loss
from boxlift.network.batch import ObjectBatch
from boxlift.network.box_parameters import BoxParameters, BoxTensors, project, to_boxes
from boxlift.network.config import DirectLossSettings
from boxlift.network.orientation import orientation_loss, ray_angle


def direct_loss(
    parameters: BoxParameters,
    targets: ObjectBatch,
    image_P_cam: Tensor,
    settings: DirectLossSettings,
    bin_overlap: float,
) -> dict[str, Tensor]:
    """Equation 6, term by term: means over the objects of positive weight. image_P_cam (N, 3, 4)."""
    boxes = to_boxes(parameters, image_P_cam, targets.frozen_size_m)
    alignment = balanced_loss(
        targets.points_cam[..., [0, 2]],
        targets.is_point,
        BevBoxes(
            center_xz=boxes.center_cam[:, [0, 2]],
            length=boxes.size_m[:, 0],
            width=boxes.size_m[:, 1],
            rotation_y=targets.heading if settings.heading == "points" else boxes.rotation_y,
        ),
        targets.origin_xz,
        settings.alignment,
    )
    count = targets.is_point.sum(-1).clamp(min=1)
    mean_y = (targets.points_cam[..., 1] * targets.is_point).sum(-1) / count
    terms = {
        "alignment": alignment,
        "y": settings.y_weight * functional.smooth_l1_loss(boxes.center_cam[:, 1], mean_y, reduction="none"),
        "orientation": settings.orientation_weight
        * _orientation(parameters, boxes, targets.heading, bin_overlap),
    }
    return _weighted_means(terms, targets.weight)


def box_loss(
    parameters: BoxParameters,
    targets: ObjectBatch,
    image_P_cam: Tensor,
    settings: DirectLossSettings,
    bin_overlap: float,
) -> dict[str, Tensor]:
    """Regression to boxes, group by group (ours): the projected centre in shares of the 2D box, log depth,

    orientation and log size; means over the objects, weighted. The term of frozen sizes is a constant.
    """
    boxes = to_boxes(parameters, image_P_cam, targets.frozen_size_m)
    center_px, depth_m = project(targets.center_cam, image_P_cam)
    extent_px = (targets.boxes_px[:, 2:] - targets.boxes_px[:, :2]).clamp(min=1)
    off_px = (parameters.center_px - center_px) / extent_px
    log_size = torch.log(targets.size_m / targets.frozen_size_m)
    terms = {
        "center": functional.smooth_l1_loss(off_px, torch.zeros_like(off_px), reduction="none", beta=0.1).sum(
            -1
        ),
        "depth": (torch.log(parameters.depth_m) - torch.log(depth_m.clamp(min=0.1))).abs(),
        "orientation": settings.orientation_weight
        * _orientation(parameters, boxes, targets.rotation_y, bin_overlap),
        "size": (parameters.log_size - log_size).abs().sum(-1),
    }
    return {name: settings.box_weight * term for name, term in _weighted_means(terms, targets.weight).items()}


def _orientation(parameters: BoxParameters, boxes: BoxTensors, heading: Tensor, overlap: float) -> Tensor:
    """The target of the local orientation: the global one, seen from the predicted centre (no gradient)."""
    alpha = heading - ray_angle(boxes.center_cam.detach())
    return orientation_loss(parameters.orientation, alpha, overlap)


def _weighted_means(terms: dict[str, Tensor], weight: Tensor) -> dict[str, Tensor]:
    # Where no object counts, the mean is 0 and still has its (zero) gradient.
    total = weight.sum().clamp(min=1e-6)
    return {name: (term * weight).sum() / total for name, term in terms.items()}
