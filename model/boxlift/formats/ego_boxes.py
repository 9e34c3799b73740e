"""Boxes of other conventions -> boxes in the ego frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from boxlift.boxes import Boxes3D
from boxlift.camera import Calibration, Floats
from boxlift.formats.details import FrameDetails, boxes3d_of_details
from boxlift.formats.kitti_label import KittiObject, boxes3d_of, from_box3d
from boxlift.poses import inverse
from boxlift.sweep import EgoObject, SweepLabels

_MOST_TRUNCATED = 0.9

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
            np.stack([sin, flat, cos], axis=1),
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


def boxes_in_camera(objects: Sequence[EgoObject], ego_SE3_cam: Floats) -> Boxes3D:
    """Boxes of the ego frame -> in a camera's, upright there: of a heading its x-z part counts."""
    cam_SE3_ego = inverse(ego_SE3_cam)
    center_ego = np.array([each.center_ego for each in objects], dtype=np.float64).reshape(-1, 3)
    heading_ego = np.array([each.ego_SO3_object[:, 0] for each in objects], dtype=np.float64).reshape(-1, 3)
    heading_cam = heading_ego @ cam_SE3_ego[:3, :3].T
    return Boxes3D(
        center_ego @ cam_SE3_ego[:3, :3].T + cam_SE3_ego[:3, 3],
        np.array([each.length_m for each in objects], dtype=np.float64),
        np.array([each.width_m for each in objects], dtype=np.float64),
        np.array([each.height_m for each in objects], dtype=np.float64),
        np.arctan2(-heading_cam[:, 2], heading_cam[:, 0]),
    )


def objects_in_view(
    objects: Sequence[EgoObject], ego_SE3_cam: Floats, calibration: Calibration, size_px: tuple[int, int]
) -> list[KittiObject]:
    """What a camera could see of boxes in the ego frame: lines whose 2D box is the outline, cut to the image.

    Left out is what lies outside the image with more than nine tenths of its outline. Whether something
    stands before an object is not known here: its occlusion is -1.
    """
    boxes = boxes_in_camera(objects, ego_SE3_cam)
    outlines = boxes.project(calibration)
    limit = np.array([*size_px, *size_px], dtype=np.float64) - 1
    lines = []
    for index, (each, outline) in enumerate(zip(objects, outlines, strict=True)):
        if np.isnan(outline).any():
            continue
        x1, y1, x2, y2 = (float(edge) for edge in outline.clip(0, limit))
        whole = float((outline[2] - outline[0]) * (outline[3] - outline[1]))
        truncated = 1 - (x2 - x1) * (y2 - y1) / max(whole, 1e-9)
        if truncated > _MOST_TRUNCATED or x2 - x1 < 1 or y2 - y1 < 1:
            continue
        box = boxes[index : index + 1]
        lines.append(from_box3d(each.category, (x1, y1, x2, y2), box, truncated=round(truncated, 2)))
    return lines


def ego_objects_of_kitti(
    objects: Sequence[KittiObject], ego_SE3_cam: Floats = LOOKING_AHEAD
) -> tuple[EgoObject, ...]:
    """KITTI lines -> their boxes, one for each line that has one; without a pose, the camera's frame is taken
    for the ego frame."""
    known = [each for each in objects if each.has_box3d]
    return ego_objects(
        boxes3d_of(known),
        ego_SE3_cam,
        [each.category for each in known],
        [1.0 if each.score is None else each.score for each in known],
    )


def sweep_labels_of_details(details: FrameDetails) -> SweepLabels:
    """What one view has of its sweep, in the ego frame of the view; without a view the camera's is taken."""
    view = details.view
    known = [(each, each.box) for each in details.objects if each.box is not None]
    objects = ego_objects(
        boxes3d_of_details([box for _, box in known]),
        LOOKING_AHEAD if view is None else np.array(view.ego_SE3_cam, dtype=np.float64),
        [each.category for each, _ in known],
        [each.score for each, _ in known],
        () if view is None else (view.camera,),
    )
    return SweepLabels(
        sweep=details.frame if view is None else view.sweep,
        objects=tuple(
            replace(
                box,
                flags=each.flags,
                points=each.points.in_cluster,
                track_id=None if each.track is None else str(each.track.id),
            )
            for box, (each, _) in zip(objects, known, strict=True)
        ),
        log="" if view is None else view.log,
        timestamp_ns=None if view is None else view.timestamp_ns,
        world_SE3_ego=None if view is None or view.world_SE3_ego is None else np.array(view.world_SE3_ego),
    )
