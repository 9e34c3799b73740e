"""The worst boxes as pictures with a line each: `accurate.py --worst DIR`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from boxlift import Boxes3D, FrameLabels
from boxlift.camera import Floats
from boxlift.datasets import FrameSource
from boxlift.drawing import draw_frame
from boxlift.evaluation import DIFFICULTIES
from boxlift.formats.kitti_label import boxes3d_of
from boxlift.overlap import iou_3d
from boxlift_client.pictures import write_picture
from judged import Judged

_HARD = DIFFICULTIES[-1]
_PEOPLE = ("Pedestrian", "Cyclist")


def print_worst(judged: Judged, source: FrameSource, folder: Path, count: int = 10) -> None:
    """Of the hard cars, and of the people: those of lowest 3D IoU, without a box first."""
    people = judged.counted(_PEOPLE[0], _HARD) | judged.counted(_PEOPLE[1], _HARD)
    for kind, counted in (("car", judged.counted("Car", _HARD)), ("person", people)):
        rows = np.flatnonzero(counted)
        for rank, row in enumerate(rows[np.argsort(judged.iou_3d[rows], kind="stable")][:count], start=1):
            name, label, truth = str(judged.frame[row]), judged.labels[row], judged.objects[row]
            picture = draw_frame(source.load(name, with_image=True), FrameLabels(name, (label,)), (truth,))
            path = folder / f"{kind}_{rank:02d}_{name}_{label.index}.png"
            write_picture(path, picture)
            x, _, z = judged.truths.boxes.center_cam[row]
            print(
                f"{path.name:24} {truth.category}, {np.hypot(x, z):.0f} m, {judged.points[row]} points, "
                f"occluded {truth.occluded}, truncated {truth.truncated:.2f}; "
                f"IoU 3D {judged.iou_3d[row]:.2f} BEV {judged.iou_bev[row]:.2f}, score {label.score:.2f}"
            )
            if label.box is None:
                print(f"    {label.sentence}")
            else:
                print(f"    {what_is_off(label.box, boxes3d_of([truth]))}\n    {', '.join(label.flags)}")


def what_is_off(box: Boxes3D, truth: Boxes3D) -> str:
    """Differences in the truth's frame, and the 3D IoU were each part alone wrong; the worst part first."""
    x, y, z = (box.center_cam - truth.center_cam)[0]
    cos, sin = np.cos(truth.rotation_y[0]), np.sin(truth.rotation_y[0])
    turned = np.degrees(box.rotation_y - truth.rotation_y)[0]
    length, width, height = ((own - true)[0] for own, true in zip(_size(box), _size(truth), strict=True))
    parts = (
        (
            f"centre {cos * x - sin * z:+.2f} m along {sin * x + cos * z:+.2f} across {y:+.2f} down",
            replace(truth, center_cam=box.center_cam),
        ),
        (
            # Front and back are the same box.
            f"heading {(turned + 90) % 180 - 90:+.0f} deg",
            replace(truth, rotation_y=box.rotation_y),
        ),
        (
            f"length {length:+.2f} m width {width:+.2f} height {height:+.2f}",
            Boxes3D(truth.center_cam, *_size(box), truth.rotation_y),
        ),
    )
    judged = sorted((float(iou_3d(wrong, truth)[0]), text) for text, wrong in parts)
    return "; ".join(f"{text} ({iou:.2f})" for iou, text in judged)


def _size(box: Boxes3D) -> tuple[Floats, Floats, Floats]:
    return box.length_m, box.width_m, box.height_m
