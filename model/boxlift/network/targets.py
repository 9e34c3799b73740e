"""What supervises the 2D boxes of a frame: object-LiDAR-points, pseudo labels, or drawn labels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxlift.boxes import Boxes3D
from boxlift.camera import Floats
from boxlift.datasets import FrameSource, load_objects
from boxlift.formats.kitti_label import boxes3d_of
from boxlift.frame import Frame
from boxlift.ground import find_ground
from boxlift.heading import heading_hypotheses
from boxlift.labeller import Labeller
from boxlift.network.config import DataSettings, FrameSet
from boxlift.object_points import ObjectPoints, points_in_image, select_object_points
from boxlift.overlap import iou_2d
from boxlift.settings import PAPER, preset

POINTS = PAPER.points.sample_count
# A drawn label belongs to the 2D box of its class that covers it best, from this IoU on.
_SAME_OBJECT_IOU = 0.5
# Where nothing supervises an object its columns hold a box here: finite numbers, of weight 0.
_SOMEWHERE_CAM = (0.0, 1.0, 10.0)


@dataclass(frozen=True)
class Targets:
    """N objects, rectified camera frame.

    weight (N,): 0 where nothing supervises an object; the other columns then hold any finite numbers.
    points_cam (N, POINTS, 3), the first point_count (N,) of them real; heading (N,) rotation_y from the
    points, modulo pi.
    center_cam (N, 3), size_m (N, 3) length, width, height, rotation_y (N,): a box.
    """

    weight: Floats
    points_cam: Floats
    point_count: NDArray[np.int64]
    heading: Floats
    center_cam: Floats
    size_m: Floats
    rotation_y: Floats


def find_targets(
    frame: Frame, rows: Sequence[int], source: FrameSource, frame_set: FrameSet, data: DataSettings
) -> Targets:
    """The targets of the prompts `rows` of a frame. Raises DatasetError where labels are not there."""
    if data.targets == "points":
        return _from_points(frame, rows)
    if data.targets == "label_2":
        return _from_labels(frame, rows, source, frame_set)
    labels = Labeller(preset(data.targets)).label(frame).objects
    boxes = [labels[row].box for row in rows]
    weight = np.array([labels[row].score for row in rows]) ** data.target_score_power
    return _from_boxes(frame, rows, boxes, weight)


def frozen_sizes(categories: Sequence[str]) -> Floats:
    """(N, 3) frozen length, width, height of classes."""
    sizes = [PAPER.sizes[category] for category in categories]
    return np.array([(s.length_m, s.width_m, s.height_m) for s in sizes], dtype=np.float64).reshape(-1, 3)


def no_targets(frame: Frame, rows: Sequence[int]) -> Targets:
    """Nothing supervises the prompts `rows`."""
    count = len(rows)
    return Targets(
        weight=np.zeros(count),
        points_cam=np.tile(_SOMEWHERE_CAM, (count, POINTS, 1)),
        point_count=np.zeros(count, dtype=np.int64),
        heading=np.zeros(count),
        center_cam=np.tile(_SOMEWHERE_CAM, (count, 1)),
        size_m=frozen_sizes([frame.prompts[row].category for row in rows]),
        rotation_y=np.zeros(count),
    )


def _from_points(frame: Frame, rows: Sequence[int]) -> Targets:
    """The paper's object-LiDAR-points and the heading from them, by the labeller's own steps."""
    visible = points_in_image(frame)
    ground = find_ground(visible.cam, frame.name, PAPER.ground)
    found = select_object_points(frame, visible, ground, PAPER.points, PAPER.sizes)
    targets = no_targets(frame, rows)
    for index, row in enumerate(rows):
        item = found[row]
        if isinstance(item, ObjectPoints):
            targets.weight[index] = 1
            targets.point_count[index] = len(item.used)
            targets.points_cam[index, : len(item.used)] = item.used
            chosen = heading_hypotheses(item.used, item.cluster, PAPER.heading)[0]
            targets.heading[index] = chosen.rotation_y
    return targets


def _from_boxes(
    frame: Frame, rows: Sequence[int], boxes: Sequence[Boxes3D | None], weight: Floats
) -> Targets:
    targets = no_targets(frame, rows)
    for index, box in enumerate(boxes):
        # A box whose centre is not before the camera has no projected centre.
        if box is not None and box.center_cam[0, 2] > 1:
            targets.weight[index] = weight[index]
            targets.center_cam[index] = box.center_cam[0]
            targets.size_m[index] = box.length_m[0], box.width_m[0], box.height_m[0]
            targets.rotation_y[index] = targets.heading[index] = box.rotation_y[0]
    return targets


def _from_labels(frame: Frame, rows: Sequence[int], source: FrameSource, frame_set: FrameSet) -> Targets:
    """Drawn labels, each at the 2D box of its class that covers it best; no label and no box twice."""
    labels = [label for label in load_objects(frame_set.labels, source, frame.name) if label.has_box3d]
    drawn_px = np.array([label.box_px for label in labels], dtype=np.float64).reshape(-1, 4)
    prompts_px = np.array([frame.prompts[row].box_px for row in rows], dtype=np.float64).reshape(-1, 4)
    first, second = np.divmod(np.arange(len(rows) * len(labels)), max(1, len(labels)))
    same = np.array(
        [frame.prompts[rows[i]].category == labels[j].category for i, j in zip(first, second, strict=True)],
        dtype=np.bool_,
    )
    iou = np.where(same, iou_2d(prompts_px[first], drawn_px[second]), 0.0)
    boxes: list[Boxes3D | None] = [None] * len(rows)
    taken = set()
    for pair in np.argsort(-iou, kind="stable"):
        index, label = int(first[pair]), int(second[pair])
        if iou[pair] >= _SAME_OBJECT_IOU and boxes[index] is None and label not in taken:
            boxes[index] = boxes3d_of([labels[label]])
            taken.add(label)
    return _from_boxes(frame, rows, boxes, np.ones(len(rows)))
