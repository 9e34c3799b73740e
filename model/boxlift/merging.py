"""Views of one sweep -> its labels, each object once.

Neighbouring cameras overlap, and both label what stands there, from the same points. Boxes of different
cameras are one object where they overlap in space, whatever classes their detectors gave: two things cannot
stand in one place. Pairs are joined from the largest overlap down, an object with at most one of each other
camera. Of an object's boxes the one with the highest score stays, mostly that of the camera that saw more of
it: what the image's border cuts off scores less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from boxlift.formats.ego_boxes import LOOKING_AHEAD, boxes_in_camera
from boxlift.overlap import iou_3d_matrix
from boxlift.sweep import EgoObject, SweepLabels

# Volumes of two cars side by side hardly touch, however badly fitted; those of one car, fitted to the points
# that two cameras saw, share more (benchmarks/merging.py).
SAME_OBJECT_IOU = 0.1


def merge_views(views: Sequence[SweepLabels], same_object_iou: float = SAME_OBJECT_IOU) -> SweepLabels:
    """The labels of a sweep from those of each of its views (one or more), best score first.

    `cameras` of an object names all that saw it. Time and pose are those of the first view that knows them.
    """
    merged = [
        _one_of([views[view].objects[index] for view, index in group])
        for group in same_objects(views, same_object_iou)
    ]
    return SweepLabels(
        sweep=views[0].sweep,
        objects=tuple(sorted(merged, key=lambda each: -each.score)),
        log=views[0].log,
        timestamp_ns=next((each.timestamp_ns for each in views if each.timestamp_ns is not None), None),
        world_SE3_ego=next((each.world_SE3_ego for each in views if each.world_SE3_ego is not None), None),
    )


def same_objects(
    views: Sequence[SweepLabels], same_object_iou: float = SAME_OBJECT_IOU
) -> list[list[tuple[int, int]]]:
    """Which boxes of a sweep's views are one object: groups of (number of the view, number of the object)."""
    members = [(number, index) for number, view in enumerate(views) for index in range(len(view.objects))]
    group_of = list(range(len(members)))
    if len(views) > 1 and members:
        objects = [views[number].objects[index] for number, index in members]
        boxes = boxes_in_camera(objects, LOOKING_AHEAD)
        iou = iou_3d_matrix(boxes, boxes)
        view_of = np.array([number for number, _ in members])
        first, second = np.nonzero(np.triu((iou >= same_object_iou) & (view_of[:, None] != view_of[None])))
        for at in np.argsort(-iou[first, second], kind="stable"):
            _join(group_of, view_of.tolist(), int(first[at]), int(second[at]))
    groups: dict[int, list[tuple[int, int]]] = {}
    for group, member in zip(group_of, members, strict=True):
        groups.setdefault(group, []).append(member)
    return list(groups.values())


def _join(group_of: list[int], view_of: list[int], first: int, second: int) -> None:
    """Makes two groups one, unless a camera would have the object twice."""
    ours, theirs = group_of[first], group_of[second]
    if ours == theirs:
        return
    views = [
        {view for view, group in zip(view_of, group_of, strict=True) if group == own}
        for own in (ours, theirs)
    ]
    if views[0] & views[1]:
        return
    for index, group in enumerate(group_of):
        if group == theirs:
            group_of[index] = ours


def _one_of(boxes: list[EgoObject]) -> EgoObject:
    best = max(boxes, key=lambda each: each.score)
    cameras = tuple(sorted({camera for each in boxes for camera in each.cameras}))
    return replace(best, cameras=cameras)
