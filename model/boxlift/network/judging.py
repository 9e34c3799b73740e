"""What a network predicts on frames, as KITTI result lines, and KITTI's figures of that."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import nn

from boxlift.boxes import Boxes3D
from boxlift.camera import Calibration, Floats
from boxlift.consistency import agree_with_prompts
from boxlift.evaluation.kitti import KittiBenchmark
from boxlift.evaluation.label_table import LabelTable, pairs_in_frames
from boxlift.evaluation.rules import DIFFICULTIES, MODERATE, IouSet, rules_of
from boxlift.formats.kitti_label import KittiObject, from_box3d
from boxlift.network.box_parameters import BoxParameters, BoxTensors, to_boxes
from boxlift.network.centernet import CenterNetwork, find_peaks
from boxlift.network.frame_batches import batch_of, stacked_images, unchanged
from boxlift.network.targets import frozen_sizes
from boxlift.network.training_frames import TrainingFrame
from boxlift.overlap import iou_2d
from boxlift.settings import PAPER

# Of average precision, in BEV and 3D (the paper has .3, .5 and .7).
_IOUS = (0.3, 0.5, 0.7)
_SAME_OBJECT_IOU = 0.5
_FIRST = ("bev_0.5_moderate", "3d_0.5_moderate", "depth_error", "recall_2d")
# Peaks of a heat below this are no objects (ours).
_COLDEST_PEAK = 0.05


@torch.no_grad()
def predict(model: nn.Module, frame: TrainingFrame, categories: Sequence[str]) -> list[KittiObject]:
    """The objects that a PaperNetwork or CenterNetwork sees in a frame.

    A PaperNetwork lifts the frame's 2D boxes, whose scores it keeps. As in the paper, y is adjusted until a
    box agrees with its 2D box.
    """
    device = next(model.parameters()).device
    sample = unchanged(frame)
    sizes = frozen_sizes(categories)
    images = stacked_images([sample.image]).to(device)
    batch = batch_of([sample], images, sizes, rays_from_lidar=False)
    P = batch.image_P_cam.to(device)
    if isinstance(model, CenterNetwork):
        peaks = find_peaks(model(images))
        warm = peaks.score > _COLDEST_PEAK
        parameters = BoxParameters(*(column[warm] for column in peaks.parameters))
        found_px = peaks.boxes_px[warm].cpu().numpy().astype(np.float64)
        height, width = sample.image.shape[:2]
        boxes_px = found_px.clip(0, (width - 1, height - 1, width - 1, height - 1))
        category = peaks.category[warm].cpu().numpy()
        score = peaks.score[warm].cpu().numpy().astype(np.float64)
    else:
        objects = batch.objects
        parameters = model(images, P, [objects.boxes_px.to(device)], [objects.frozen_size_m.to(device)])
        boxes_px, category, score = frame.boxes_px, frame.category, frame.score
    frozen = torch.from_numpy(sizes[category]).to(device, torch.float32)
    boxes = _agreeing(to_boxes(parameters, P[0], frozen), boxes_px, frame, sample.image.shape)
    return [
        from_box3d(categories[category[i]], tuple(boxes_px[i].tolist()), boxes[i : i + 1], float(score[i]))
        for i in range(len(boxes))
    ]


def judge(
    predictions: Sequence[Sequence[KittiObject]],
    truths: Sequence[Sequence[KittiObject]],
    categories: Sequence[str],
) -> dict[str, float]:
    """AP (R40, percent) in BEV and 3D by class, IoU and difficulty, and the median relative depth error.

    The depth error is that of moderate truths (and the share of them that has a 2D box at IoU .5 is their
    recall_2d). What there is no truth for is left out. Moderate at IoU .5 and the depth come first.
    """
    truth, found = LabelTable.from_frames(truths), LabelTable.from_frames(predictions)
    benchmark = KittiBenchmark(truth, found)
    figures: dict[str, float] = {}
    for category in categories:
        in_image = rules_of(category).strict_iou
        sets = [IouSet(in_image, iou, iou) for iou in _IOUS]
        judged = [ap for ap in benchmark.average_precision(category, sets) if ap.recall_points == "R40"]
        for ap in judged:
            for metric, values in (("bev", ap.ap_bev), ("3d", ap.ap_3d)):
                for difficulty, value in zip(DIFFICULTIES, values, strict=True):
                    if value is not None:
                        figures[f"{category}/{metric}_{ap.iou_3d:g}_{difficulty.name}"] = value
        figures |= _depth_error(truth, found, category)
    first = [name for name in figures if name.endswith(_FIRST)]
    return {name: figures[name] for name in (*first, *(name for name in figures if name not in first))}


def _depth_error(truth: LabelTable, found: LabelTable, category: str) -> dict[str, float]:
    counted = truth.rows(truth.is_any_of([category]) & truth.counts_as(MODERATE))
    of_class = found.rows(found.is_any_of([category]))
    rows, columns = pairs_in_frames(counted, of_class)
    iou = iou_2d(counted.box_px[rows], of_class.box_px[columns])
    # From the worst pair to the best, so that each truth keeps its best.
    best = np.full(len(counted), -1)
    for pair in np.argsort(iou, kind="stable"):
        if iou[pair] >= _SAME_OBJECT_IOU:
            best[rows[pair]] = columns[pair]
    matched = best >= 0
    if not len(counted) or not matched.any():
        return {}
    true_z = counted.boxes.center_cam[matched, 2]
    error = np.abs(of_class.boxes.center_cam[best[matched], 2] - true_z) / true_z
    return {
        f"{category}/depth_error": float(np.median(error)),
        f"{category}/recall_2d": float(matched.mean()),
    }


def _agreeing(
    boxes: BoxTensors, boxes_px: Floats, frame: TrainingFrame, image_shape: tuple[int, ...]
) -> Boxes3D:
    length, width, height = boxes.size_m.double().cpu().numpy().T
    found = Boxes3D(
        boxes.center_cam.double().cpu().numpy(),
        length,
        width,
        height,
        boxes.rotation_y.double().cpu().numpy(),
    )
    # Where the LiDAR is does not matter here.
    calibration = Calibration(frame.image_P_cam, np.eye(4))
    size_px = image_shape[1], image_shape[0]
    return agree_with_prompts(found, boxes_px, calibration, size_px, PAPER.consistency)
