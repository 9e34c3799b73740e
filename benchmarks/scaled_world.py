"""Real frames of a larger or a smaller world: do the labels hold where cars are of another size?

    python benchmarks/scaled_world.py [FOLDER] [--scales .9 1 1.15 1.2]

Points, the LiDAR's place, the camera's offset and the truths are scaled; the image stays the same, as a
projection cannot tell. A world 15 % larger has cars as long and wide as those of North America.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import torch

from ablation import Dataset, kitti, recall_of
from boxlift.camera import Calibration
from boxlift.formats.kitti_label import KittiObject
from boxlift.frame import Frame
from boxlift.settings import ACCURATE
from label_http import DEFAULT_FOLDER


def scaled(data: Dataset, scale: float) -> Dataset:
    """The same pictures of a world `scale` times as large."""
    return replace(
        data,
        frames=[_scaled_frame(frame, scale) for frame in data.frames],
        truths={name: [_scaled_object(item, scale) for item in items] for name, items in data.truths.items()},
    )


def _scaled_frame(frame: Frame, scale: float) -> Frame:
    points_velo = frame.points_velo.copy()
    points_velo[:, :3] *= scale
    image_P_cam = frame.calibration.image_P_cam.copy()
    cam_SE3_velo = frame.calibration.cam_SE3_velo.copy()
    image_P_cam[:, 3] *= scale
    cam_SE3_velo[:3, 3] *= scale
    return replace(frame, points_velo=points_velo, calibration=Calibration(image_P_cam, cam_SE3_velo))


def _scaled_object(item: KittiObject, scale: float) -> KittiObject:
    if not item.has_box3d:
        return item
    height, width, length = (side * scale for side in item.size_hwl_m)
    x, y, z = (axis * scale for axis in item.bottom_center_cam)
    return replace(item, size_hwl_m=(height, width, length), bottom_center_cam=(x, y, z))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=DEFAULT_FOLDER)
    parser.add_argument("--scales", nargs="+", type=float, default=[0.9, 1.0, 1.15, 1.2])
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    data = kitti(arguments.folder)
    print("scale  cars      n   bev@.5  3d@.5  bev@.7  3d@.7")
    for scale in arguments.scales:
        (_, moderate, hard), *_ = recall_of(ACCURATE, scaled(data, scale)).values()
        for name, recall in (("moderate", moderate), ("hard", hard)):
            cells = "  ".join(f"{value:6.3f}" for value in recall.values)
            print(f"{scale:5.2f}  {name:8} {recall.cars:3d}  {cells}")


if __name__ == "__main__":
    main()
