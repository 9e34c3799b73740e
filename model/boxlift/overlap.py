"""Overlap of boxes: axis-aligned in the image, rotated in the bird's-eye view (BEV), and in 3D.

Every function takes two sets of boxes of the same length N and compares a[i] with b[i]; the `_matrix`
forms compare each of N with each of M. IoU is intersection over union, in [0, 1]; a box without area
(or volume) overlaps nothing.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from boxlift.boxes import Boxes3D
from boxlift.camera import Floats


def intersection_2d(boxes_px_a: Floats, boxes_px_b: Floats) -> Floats:
    """(N, 4) and (N, 4) boxes x1, y1, x2, y2 -> (N,) areas in square pixels that both cover."""
    low = np.maximum(boxes_px_a[:, :2], boxes_px_b[:, :2])
    high = np.minimum(boxes_px_a[:, 2:], boxes_px_b[:, 2:])
    width, height = (high - low).clip(0).T
    covered: Floats = width * height
    return covered


def area_2d(boxes_px: Floats) -> Floats:
    """(N, 4) boxes x1, y1, x2, y2 -> (N,) areas in square pixels."""
    width, height = (boxes_px[:, 2:] - boxes_px[:, :2]).clip(0).T
    area: Floats = width * height
    return area


def iou_2d(boxes_px_a: Floats, boxes_px_b: Floats) -> Floats:
    """(N, 4) and (N, 4) image boxes -> (N,) IoU. A box's width is x2 - x1, as KITTI has it (no + 1)."""
    return _over_union(intersection_2d(boxes_px_a, boxes_px_b), area_2d(boxes_px_a), area_2d(boxes_px_b))


def bev_iou(boxes_a: Boxes3D, boxes_b: Boxes3D) -> Floats:
    """(N,) IoU of a[i] and b[i] seen from above."""
    return _over_union(bev_intersection(boxes_a, boxes_b), _bev_area(boxes_a), _bev_area(boxes_b))


def iou_3d(boxes_a: Boxes3D, boxes_b: Boxes3D) -> Floats:
    """(N,) IoU of a[i] and b[i] as volumes; boxes stand upright, so it is BEV times vertical overlap."""
    low = np.maximum(boxes_a.bottom_y - boxes_a.height_m, boxes_b.bottom_y - boxes_b.height_m)
    high = np.minimum(boxes_a.bottom_y, boxes_b.bottom_y)
    return _over_union(
        bev_intersection(boxes_a, boxes_b) * (high - low).clip(0),
        _bev_area(boxes_a) * boxes_a.height_m.clip(0),
        _bev_area(boxes_b) * boxes_b.height_m.clip(0),
    )


def bev_iou_matrix(boxes_a: Boxes3D, boxes_b: Boxes3D) -> Floats:
    """(N, M) IoU of each of a with each of b, seen from above."""
    return _matrix(bev_iou, boxes_a, boxes_b)


def iou_3d_matrix(boxes_a: Boxes3D, boxes_b: Boxes3D) -> Floats:
    """(N, M) IoU of each of a with each of b, as volumes."""
    return _matrix(iou_3d, boxes_a, boxes_b)


def bev_intersection(boxes_a: Boxes3D, boxes_b: Boxes3D) -> Floats:
    """(N,) areas in square metres that a[i] and b[i] both cover, seen from above.

    In the frame of b the box b is |u| <= l/2, |v| <= w/2. Green's theorem gives the area of a as the
    integral of v du around its boundary; with v clamped to +-w/2 and u limited to +-l/2 it is the area of
    a within b. Along an edge v is linear in u, so that the clamped integral is three trapezoids: no
    polygon is built, nothing is sorted, and boxes that share edges or corners are no special case.
    """
    reach = np.hypot(boxes_a.length_m, boxes_a.width_m) + np.hypot(boxes_b.length_m, boxes_b.width_m)
    apart = boxes_a.center_cam - boxes_b.center_cam
    near = np.flatnonzero(np.hypot(apart[:, 0], apart[:, 2]) < reach / 2)
    area = np.zeros(len(boxes_a))
    if len(near) == 0:
        return area
    a, b = boxes_a[near], boxes_b[near]

    # Corners of a in the frame of b, in order around the box; rotation_y turns +x towards -z.
    turn = a.rotation_y - b.rotation_y
    cos_b, sin_b = np.cos(b.rotation_y), np.sin(b.rotation_y)
    cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
    along = a.length_m.clip(0)[:, None] * np.array([0.5, -0.5, -0.5, 0.5])
    across = a.width_m.clip(0)[:, None] * np.array([0.5, 0.5, -0.5, -0.5])
    x, z = apart[near, 0], apart[near, 2]
    u = (cos_b * x - sin_b * z)[:, None] + cos * along + sin * across
    v = (sin_b * x + cos_b * z)[:, None] - sin * along + cos * across
    half_u, half_v = b.length_m.clip(0)[:, None] / 2, b.width_m.clip(0)[:, None] / 2

    # Each edge, cut to |u| <= l/2.
    step_u, step_v = np.roll(u, -1, axis=1) - u, np.roll(v, -1, axis=1) - v
    start_u, end_u = u.clip(-half_u, half_u), (u + step_u).clip(-half_u, half_u)
    start_v = v + _fraction(start_u - u, step_u) * step_v
    end_v = v + _fraction(end_u - u, step_u) * step_v

    # Mean of v, clamped, along the cut edge: trapezoids between its ends and where it crosses +-w/2.
    rise = end_v - start_v
    crossings = np.sort([_fraction(-half_v - start_v, rise), _fraction(half_v - start_v, rise)], axis=0)
    at = np.stack([np.zeros_like(rise), *crossings, np.ones_like(rise)])
    clamped = (start_v + at * rise).clip(-half_v, half_v)
    mean_v = ((clamped[1:] + clamped[:-1]) / 2 * np.diff(at, axis=0)).sum(axis=0)

    # Against the sense of the integral: in the order of the corners u falls where v is high.
    area[near] = (mean_v * (start_u - end_u)).sum(axis=1).clip(0)
    return area


def _bev_area(boxes: Boxes3D) -> Floats:
    area: Floats = boxes.length_m.clip(0) * boxes.width_m.clip(0)
    return area


def _fraction(part: Floats, whole: Floats) -> Floats:
    """part / whole in [0, 1]; 0 where there is no whole."""
    ratio = np.divide(part, whole, out=np.zeros_like(part), where=whole != 0)
    return ratio.clip(0, 1)


def _over_union(intersection: Floats, area_a: Floats, area_b: Floats) -> Floats:
    union = area_a + area_b - intersection
    ratio = np.divide(intersection, union, out=np.zeros_like(intersection), where=union > 0)
    return ratio.clip(0, 1)


def _matrix(iou: Callable[[Boxes3D, Boxes3D], Floats], boxes_a: Boxes3D, boxes_b: Boxes3D) -> Floats:
    rows: NDArray[np.int64] = np.repeat(np.arange(len(boxes_a)), len(boxes_b))
    columns: NDArray[np.int64] = np.tile(np.arange(len(boxes_b)), len(boxes_a))
    return iou(boxes_a[rows], boxes_b[columns]).reshape(len(boxes_a), len(boxes_b))
