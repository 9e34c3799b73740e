"""Boxes of other conventions -> boxes in the ego frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from boxlift.boxes import Boxes3D
from boxlift.camera import Floats
from boxlift.formats.details import FrameDetails
from boxlift.formats.kitti_label import KittiObject, boxes3d_of
from boxlift.sweep import EgoObject

# A camera that looks ahead, taken for the ego frame: x = z of the camera, y = -x, z = -y.
LOOKING_AHEAD = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]], dtype=np.float64)


def ego_objects(
    boxes: Boxes3D,
    ego_SE3_cam: Floats,
    categories: Sequence[str],
    scores: Sequence[float],
    cameras: tuple[str, ...] = (),
) -> tuple[EgoObject, ...]:
    """Boxes of a camera -> in the ego frame. categories, scores: (N,)."""
    rotation, origin = ego_SE3_cam[:3, :3], ego_SE3_cam[:3, 3]
    centers = boxes.center_cam @ rotation.T + origin
    cos, sin = np.cos(boxes.rotation_y), np.sin(boxes.rotation_y)
    flat = np.zeros_like(cos)
    # Columns: to the front, to the left, up.
    cam_SO3_object = np.stack(
        [
            np.stack([cos, flat, -sin], axis=1),
            np.stack([-sin, flat, -cos], axis=1),
            np.stack([flat, flat - 1, flat], axis=1),
        ],
        axis=2,
    )
    return tuple(
        EgoObject(
            category=categories[index],
            center_ego=centers[index],
            ego_SO3_object=rotation @ cam_SO3_object[index],
            length_m=float(boxes.length_m[index]),
            width_m=float(boxes.width_m[index]),
            height_m=float(boxes.height_m[index]),
            score=scores[index],
            cameras=cameras,
        )
        for index in range(len(boxes))
    )


def ego_objects_of_kitti(objects: Sequence[KittiObject]) -> tuple[EgoObject, ...]:
    """KITTI lines with a 3D box -> their boxes, the camera's frame taken for the ego frame."""
    known = [each for each in objects if each.has_box3d]
    return ego_objects(
        boxes3d_of(known),
        LOOKING_AHEAD,
        [each.category for each in known],
        [1.0 if each.score is None else each.score for each in known],
    )


def ego_objects_of_details(details: FrameDetails) -> tuple[EgoObject, ...]:
    """What a view has of its sweep -> in the ego frame of the view; without a view the camera's is taken."""
    view = details.view
    known = [(each, each.box) for each in details.objects if each.box is not None]
    boxes = Boxes3D(
        np.array([box.center_cam for _, box in known], dtype=np.float64).reshape(-1, 3),
        np.array([box.length_m for _, box in known], dtype=np.float64),
        np.array([box.width_m for _, box in known], dtype=np.float64),
        np.array([box.height_m for _, box in known], dtype=np.float64),
        np.array([box.rotation_y for _, box in known], dtype=np.float64),
    )
    return ego_objects(
        boxes,
        LOOKING_AHEAD if view is None else np.array(view.ego_SE3_cam, dtype=np.float64),
        [each.category for each, _ in known],
        [each.score for each, _ in known],
        () if view is None else (view.camera,),
    )


def rotation_of(quaternions_wxyz: Floats) -> Floats:
    """(N, 4) quaternions w, x, y, z of any length but 0 -> (N, 3, 3) rotations."""
    w, x, y, z = (quaternions_wxyz / np.linalg.norm(quaternions_wxyz, axis=1, keepdims=True)).T
    rows: Floats = np.stack(
        [
            *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        ],
        axis=1,
    ).reshape(-1, 3, 3)
    return rows
