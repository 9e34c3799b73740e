"""Exact KITTI labels and instance masks of a scene as one rig sees it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxlift.boxes import Boxes3D
from boxlift.camera import Calibration, Floats
from boxlift.datasets.generated.meshes import Mesh
from boxlift.datasets.generated.rig import Rig
from boxlift.datasets.generated.scene import Scene, SceneObject
from boxlift.datasets.generated.sensors import camera_rays, scene_to_cam, silhouette
from boxlift.formats.kitti_label import UNKNOWN_ANGLE, UNKNOWN_LOCATION, UNKNOWN_SIZE, KittiObject, from_box3d

# KITTI's annotators had three words for occlusion; these shares of visible pixels are ours.
_FULLY_VISIBLE, _PARTLY_VISIBLE = 0.88, 0.45
# Less than this is a region that nobody should be judged by.
_MIN_HEIGHT_PX, _MIN_VISIBLE, _MIN_PIXELS, _MAX_TRUNCATED = 8.0, 0.05, 12, 0.95
_NEAR_PLANE_M = 0.1
_SILHOUETTE_RAYS = 4000


@dataclass(frozen=True)
class Labelled:
    """Label lines, and for every object of the scene its number in the masks (0: no line of its own)."""

    lines: tuple[KittiObject, ...]
    mask_number: NDArray[np.uint16]


def label(scene: Scene, rig: Rig, object_px: NDArray[np.int64]) -> Labelled:
    """Labels of the objects in the picture; object_px (H, W) is the object that each pixel shows, or -1."""
    origin, directions = camera_rays(rig)
    lines: list[KittiObject] = []
    ignored: list[KittiObject] = []
    mask_number = np.zeros(len(scene.objects), dtype=np.uint16)
    for index, item in enumerate(scene.objects):
        uncut = image_box(item.mesh, rig)
        box = _cut(uncut, rig.image_size_px)
        if box is None:
            continue
        columns, rows = _sample_pixels(box)
        alone = silhouette(item.mesh, origin, directions[rows, columns])
        shown = object_px[rows, columns] == index
        if not alone.any() or not shown.any():
            continue
        visible = float((alone & shown).sum() / alone.sum())
        box_px = (round(box[0], 2), round(box[1], 2), round(box[2], 2), round(box[3], 2))
        truncated = round(1 - _area(box) / _area(uncut), 2)
        too_little = (
            truncated > _MAX_TRUNCATED
            or box[3] - box[1] < _MIN_HEIGHT_PX
            or visible < _MIN_VISIBLE
            or int((object_px == index).sum()) < _MIN_PIXELS
        )
        if too_little:
            ignored.append(_dont_care(box_px))
            continue
        occluded = 0 if visible >= _FULLY_VISIBLE else 1 if visible >= _PARTLY_VISIBLE else 2
        lines.append(from_box3d(item.category, box_px, truth_box(item, rig), None, truncated, occluded))
        mask_number[index] = len(lines)
    return Labelled(tuple(lines + ignored), mask_number)


def truth_box(item: SceneObject, rig: Rig) -> Boxes3D:
    """The object's box (length 1) in the rectified camera frame."""
    length, width, height = item.size_lwh_m
    center = scene_to_cam(np.array(item.bottom_center) + np.array([0, 0, height / 2]), rig)
    rotation_y = item.rotation_y + np.deg2rad(rig.camera_yaw_deg) + rig.car_heading_rad
    sides = (np.array([side]) for side in (length, width, height, rotation_y))
    return Boxes3D(center[None], *sides)


def image_box(mesh: Mesh, rig: Rig) -> Floats:
    """(4,) x1, y1, x2, y2 around the mesh's outline, not cut to the image; NaN behind the camera."""
    calibration = rig.calibration
    vertices = scene_to_cam(mesh.vertices, rig)
    if vertices[:, 2].min() < _NEAR_PLANE_M:
        vertices = _in_front(vertices, mesh.triangles, calibration)
    if len(vertices) == 0:
        return np.full(4, np.nan)
    pixels, _ = calibration.project(vertices)
    return np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])


def _in_front(vertices: Floats, triangles: NDArray[np.int64], calibration: Calibration) -> Floats:
    """Vertices before the near plane, and where edges pass through it."""
    near = _NEAR_PLANE_M - calibration.image_P_cam[2, 3]
    starts, ends = vertices[triangles].reshape(-1, 3), vertices[np.roll(triangles, -1, 1)].reshape(-1, 3)
    crossing = (starts[:, 2] - near) * (ends[:, 2] - near) < 0
    starts, ends = starts[crossing], ends[crossing]
    share = (near - starts[:, 2]) / (ends[:, 2] - starts[:, 2])
    return np.concatenate([vertices[vertices[:, 2] >= near], starts + share[:, None] * (ends - starts)])


def _cut(box: Floats, image_size_px: tuple[int, int]) -> Floats | None:
    width, height = image_size_px
    cut = np.clip(box, 0, np.array([width - 1, height - 1, width - 1, height - 1]))
    return cut if cut[2] - cut[0] >= 1 and cut[3] - cut[1] >= 1 else None


def _area(box: Floats) -> float:
    return float((box[2] - box[0]) * (box[3] - box[1]))


def _sample_pixels(box: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Columns and rows of a regular sample of the pixels in a box."""
    step = max(1, int(np.sqrt(_area(box) / _SILHOUETTE_RAYS)))
    columns = np.arange(int(np.ceil(box[0])), int(box[2]) + 1, step)
    rows = np.arange(int(np.ceil(box[1])), int(box[3]) + 1, step)
    grid = np.meshgrid(columns, rows)
    return grid[0].ravel(), grid[1].ravel()


def _dont_care(box_px: tuple[float, float, float, float]) -> KittiObject:
    return KittiObject(
        "DontCare", -1.0, -1, UNKNOWN_ANGLE, box_px, UNKNOWN_SIZE, UNKNOWN_LOCATION, UNKNOWN_ANGLE
    )
