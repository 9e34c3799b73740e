from __future__ import annotations

from pathlib import Path

import numpy as np

from boxlift.datasets import load_objects, load_prompts, open_source
from boxlift.errors import NoLidarError
from boxlift.formats.kitti_label import boxes3d_of
from boxlift.labeller import Labeller
from boxlift.overlap import iou_3d


def test_nine_of_ten_moderate_cars_reach_an_overlap_of_a_half(kitti_object_root: Path) -> None:
    """By 3D IoU, from the 2D boxes of the labels."""
    source = open_source(kitti_object_root)
    labeller = Labeller()
    overlaps = []
    for name in source.names:
        try:
            frame = source.load(name, load_prompts("label_2", source, name))
        except NoLidarError:
            continue
        truths = [o for o in load_objects("label_2", source, name) if o.category != "DontCare"]
        for truth, label in zip(truths, labeller.label(frame).objects, strict=True):
            tall = truth.box_px[3] - truth.box_px[1] >= 25
            if truth.category == "Car" and tall and truth.occluded <= 1 and truth.truncated <= 0.3:
                overlaps.append(
                    0.0 if label.box is None else float(iou_3d(label.box, boxes3d_of([truth]))[0])
                )
    assert len(overlaps) >= 50
    assert np.mean(np.array(overlaps) > 0.5) >= 0.9
