"""Objects made by hand with everything that a loss may ask for."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from boxlift.network.batch import ObjectBatch
from boxlift.network.box_parameters import BoxParameters, project
from boxlift.network.orientation import bin_middles
from model.small_frame import CALIBRATION, car, face_points

PLACES = ((-4.0, 14.0, -1.5), (3.0, 25.0, -0.4), (1.0, 8.0, -2.9))
PROJECTION = torch.from_numpy(CALIBRATION.image_P_cam.copy())
SIZE_M = (4.0, 1.8, 1.6)


def objects(dtype: torch.dtype = torch.float64, points: int = 60) -> ObjectBatch:
    """Cars at PLACES, seen by the camera of small_frame, without noise in what is drawn."""
    boxes = [car(*place) for place in PLACES]
    seen = np.stack([face_points(box, np.random.default_rng(2), points) for box in boxes])
    edges = np.concatenate([box.project(CALIBRATION) for box in boxes])
    columns = {
        "boxes_px": edges,
        "frozen_size_m": np.tile(SIZE_M, (len(boxes), 1)),
        "weight": np.ones(len(boxes)),
        "points_cam": seen,
        "heading": np.array([place[2] for place in PLACES]),
        "origin_xz": np.zeros((len(boxes), 2)),
        "center_cam": np.concatenate([box.center_cam for box in boxes]),
        "size_m": np.tile(SIZE_M, (len(boxes), 1)),
        "rotation_y": np.array([place[2] for place in PLACES]),
    }
    tensors = {name: torch.from_numpy(values).to(dtype) for name, values in columns.items()}
    return ObjectBatch(
        category=torch.zeros(len(boxes), dtype=torch.int64),
        is_point=torch.ones(len(boxes), points, dtype=torch.bool),
        **tensors,
    )


def perfect(targets: ObjectBatch, bins: int = 2) -> BoxParameters:
    """What a network that knows the drawn boxes would say."""
    center_px, depth_m = project(targets.center_cam, PROJECTION.to(targets.center_cam.dtype))
    ray = torch.atan2(targets.center_cam[:, 0], targets.center_cam[:, 2])
    orientation = torch.zeros(len(ray), bins, 3, dtype=ray.dtype)
    off = 2 * (targets.rotation_y - ray)[:, None] - bin_middles(orientation)
    orientation = torch.stack([10 * torch.cos(off), torch.cos(off), torch.sin(off)], dim=-1)
    return BoxParameters(center_px, depth_m, orientation, torch.zeros_like(targets.size_m))


def projections(targets: ObjectBatch) -> Tensor:
    """(N, 3, 4) the camera of every object."""
    return PROJECTION.to(targets.center_cam.dtype).expand(len(targets.weight), 3, 4)
