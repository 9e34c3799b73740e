"""One box from what many frames saw: the paper's losses on all points, then a polish against all prompts.

Everything is taken into the object's frame (x front, y down, z left; see paths.py), in which an object stands
still whether it moved or not. The rays of the ray-tracing loss start where each frame's did.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from boxlift.accurate.evidence import weigh
from boxlift.accurate.parameters import BOTTOM, HEIGHT, LENGTH, WIDTH, YAW, X, Z, to_box_frame, to_boxes
from boxlift.accurate.polish import (
    POINTS_WORTH,
    YAW_RAD,
    SizePull,
    Target,
    Viewpoint,
    outline_distance,
    polish,
)
from boxlift.accurate.weights import EVIDENCE_WEIGHTS
from boxlift.boxes import wrap_angle
from boxlift.extras import open3d
from boxlift.fit import FitProblem, fit_boxes
from boxlift.frame import LossTerms
from boxlift.overlap import bev_iou_matrix
from boxlift.poses import Floats, inverse
from boxlift.settings import LabellerSettings
from boxlift.tracking.glimpses import Glimpse, moved
from boxlift.tracking.paths import Path

_MOST_VIEWS = 12
_STEPS = 15
# Points in the uppermost fifth are inside the outline (windows, roof).
_OUTLINE_SHARE = 0.8
# Boxes of single frames that are tried as starts, beside what most of them say.
_STARTS = 4
# What a hypothesis that overlaps all boxes of the single frames has over one that overlaps none (ours).
_AGREEMENT_WORTH = 10.0
# Sides of which the points show less than this share say nothing of the size.
_SEEN_SHARE = 0.6
# The points of n frames weigh as much as those of n to this power: their errors are alike.
_MORE = 0.2
# What lies farther from the middle of the object than this is not looked at.
_AROUND_M = 8.0
_CELL_M = 0.1
# Things farther apart than this are two. Of an object's cells this share lies in its box, give or take.
_APART_M, _OWN_SHARE, _NEAR_M = 0.45, 0.6, 0.4
_ROUNDS = 2
# Seen from many sides an object shows more of what lies within its outline than to one frame.
_INSIDE_M = 0.6
# What moves looks along its path, give or take.
_PATH_YAW_RAD = 0.1
# The span of the points along a box, without this share at either end and with this much more, is its length
# where it is more than this share of the class's; give or take, and more the less is seen.
_SPAN_TAIL, _SPAN_MORE_M, _SPAN_SHARE = 0.02, 0.05, 0.75
_SPAN_SIGMA_M, _SPAN_HIDDEN = 0.15, 0.4
_FEWEST_POINTS = 3


@dataclass(frozen=True)
class FusedBox:
    """A box (7,) in the object's frame.

    losses: the paper's, at the minimum that the polish began at; None with too few points for a fit. points:
    cells of points that it was fitted to. agreement: mean overlap seen from above with the boxes of the
    single frames, by score. energy: what the frames have against it, on average; None without points.
    own_energy: of what moves, what they have against their own boxes. shows_size: whether the points reach
    along most of its length and of its width.
    """

    parameters: Floats
    losses: LossTerms | None
    points: int
    agreement: float
    energy: float | None
    own_energy: float | None
    shows_size: bool

    @property
    def cost(self) -> float:
        """What speaks against it, the boxes of the single frames counted."""
        return (np.inf if self.energy is None else self.energy) - _AGREEMENT_WORTH * self.agreement


@dataclass(frozen=True)
class _Cloud:
    """What all frames saw around the object, thinned: (N, 3) means of the points in cells seen from above.

    origins: (N, 3) where the ray of one of them starts. group: (N,) number of the thing that a cell belongs
    to, -1 for none. All in the object's frame.
    """

    points: Floats
    origins: Floats
    group: NDArray[np.intp]

    @classmethod
    def of(
        cls, glimpses: Sequence[Glimpse], path: Path, bottom: float, height_m: float, ray_origin: str
    ) -> _Cloud:
        """The points that are not windows or roof, which lie inside the outline."""
        points, origins = [np.empty((0, 3))], [np.empty((0, 3))]
        for each in glimpses:
            object_SE3_world = inverse(path.world_SE3_object(each.sweep))
            seen = moved(object_SE3_world, each.points_world)
            near = (np.hypot(seen[:, 0], seen[:, 2]) < _AROUND_M) & (
                bottom - seen[:, 1] < _OUTLINE_SHARE * height_m
            )
            points.append(seen[near])
            origin = moved(object_SE3_world, each.origin_world(ray_origin))
            origins.append(np.broadcast_to(origin, points[-1].shape))
        thinned, rows = _means_of_cells(np.concatenate(points))
        return cls(thinned, np.concatenate(origins)[rows], _groups(thinned))

    def on(self, box: Floats) -> NDArray[np.bool_]:
        """(N,) the cells in a box (7,) or near it, but for those of things that mostly are not."""
        near = outline_distance(box[None], self.points[:, [0, 2]])[0] < _NEAR_M
        foreign = [
            group for group in np.unique(self.group[near]) if near[self.group == group].mean() < _OWN_SHARE
        ]
        own: NDArray[np.bool_] = near & ~np.isin(self.group, foreign)
        return own if own.sum() >= _FEWEST_POINTS else near


def _means_of_cells(points: Floats) -> tuple[Floats, NDArray[np.intp]]:
    """(N, 3) -> (C, 3) means by cell seen from above, and a row of each."""
    cells = np.floor(points[:, [0, 2]] / _CELL_M).astype(np.int64)
    _, rows, inverse_rows, counts = np.unique(
        cells, axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    sums = np.zeros((len(rows), 3))
    np.add.at(sums, inverse_rows.reshape(-1), points)
    return sums / counts[:, None], rows


def _groups(points: Floats) -> NDArray[np.intp]:
    """(N,) things apart from each other, by DBSCAN as everywhere else."""
    if len(points) == 0:
        return np.empty(0, dtype=np.intp)
    o3d = open3d()
    flat = points * np.array([1.0, 0.0, 1.0])
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(flat))
    return np.asarray(cloud.cluster_dbscan(_APART_M, 2), dtype=np.intp)


def fit_fused(
    glimpses: Sequence[Glimpse],
    path: Path,
    boxes: Floats,
    scores: Floats,
    size: SizePull,
    settings: LabellerSettings,
) -> FusedBox:
    """The box of an object from what frames saw of it.

    boxes (S, 7), scores (S,): what single frames made of it, in the object's frame.
    """
    starts = _starts(boxes, scores, size, path)
    bottom, height_m = float(starts[0, BOTTOM]), float(starts[0, HEIGHT])
    cloud = _Cloud.of(glimpses, path, bottom, height_m, settings.loss.ray_origin)
    own = [cloud.on(start) for start in starts]
    enough = [mask.sum() >= _FEWEST_POINTS for mask in own]
    if not any(enough):
        agreement = float(_agreement(starts[:1], boxes, scores)[0])
        return FusedBox(starts[0], None, 0, agreement, None, None, shows_size=False)
    own = [mask for mask in own if mask.sum() >= _FEWEST_POINTS]
    starts, losses = _fitted(starts[enough], own, cloud, settings)
    views = _evenly(glimpses, _MOST_VIEWS)
    for _ in range(_ROUNDS):
        target, viewpoints = _target(cloud, own, views, path, starts, size, settings)
        starts, _ = polish(starts, target, viewpoints, _STEPS)
        own = [cloud.on(start) for start in starts]
    energy = np.mean([_energy(each, path, starts, size, settings) for each in views], axis=0)
    agreements = _agreement(starts, boxes, scores)
    best = int((energy - _AGREEMENT_WORTH * agreements).argmin())
    return FusedBox(
        starts[best],
        losses[best],
        int(own[best].sum()),
        float(agreements[best]),
        float(energy[best]),
        None if path.stands else float(np.mean([_own_energy(each, size, settings) for each in views])),
        _shows_size(starts[best], cloud.points[own[best]]),
    )


def _agreement(parameters: Floats, boxes: Floats, scores: Floats) -> Floats:
    """(B,) mean overlap of boxes (B, 7) with those of the single frames (S, 7), by score (S,)."""
    overlap = bev_iou_matrix(to_boxes(parameters), to_boxes(boxes))
    mean: Floats = overlap @ scores / max(float(scores.sum()), 1e-9)
    return mean


def _shows_size(box: Floats, points: Floats) -> bool:
    along, across = (axis[0] for axis in to_box_frame(box[None], points[:, [0, 2]]))
    seen = np.ptp(along) / box[LENGTH], np.ptp(across) / box[WIDTH]
    return bool(min(seen) > _SEEN_SHARE)


def _energy(
    seen: Glimpse, path: Path, parameters: Floats, size: SizePull, settings: LabellerSettings
) -> Floats:
    """(B,) what one frame has against boxes (B, 7), as in the labelling of single frames."""
    cam_SE3_object = inverse(seen.world_SE3_cam) @ path.world_SE3_object(seen.sweep)
    in_camera = transformed(parameters, cam_SE3_object)
    use_edges = settings.repairs is None or settings.repairs.edges
    return weigh(seen.view, seen.region, in_camera, size, use_edges=use_edges).energy(EVIDENCE_WEIGHTS)


def _own_energy(seen: Glimpse, size: SizePull, settings: LabellerSettings) -> float:
    """What a frame has against its own box."""
    use_edges = settings.repairs is None or settings.repairs.edges
    evidence = weigh(seen.view, seen.region, seen.own[None], size, use_edges=use_edges)
    return float(evidence.energy(EVIDENCE_WEIGHTS)[0])


def transformed(parameters: Floats, a_SE3_b: Floats) -> Floats:
    """Boxes (B, 7) of frame b -> in frame a, upright there: of a heading its x-z part counts."""
    x, z, yaw, _, _, _, bottom = parameters.T
    places = moved(a_SE3_b, np.stack([x, bottom, z], axis=1))
    flat = np.zeros_like(yaw)
    headings = np.stack([np.cos(yaw), flat, -np.sin(yaw)], axis=1) @ a_SE3_b[:3, :3].T
    in_a = parameters.copy()
    in_a[:, X], in_a[:, BOTTOM], in_a[:, Z] = places.T
    in_a[:, YAW] = np.arctan2(-headings[:, 2], headings[:, 0])
    return in_a


def _starts(boxes: Floats, scores: Floats, size: SizePull, path: Path) -> Floats:
    """(B, 7) what most frames say, the same turned by a right angle, and the most trusted frames; of what
    moves the heading is known."""
    common = np.array([_weighted_median(column, scores) for column in boxes.T])
    # Headings wrap: those that look like the frame's own are near 0, front and back alike.
    common[YAW] = 0.0
    turned = common.copy()
    turned[YAW] = np.pi / 2
    turned[LENGTH : HEIGHT + 1] = size.lwh_m
    trusted = boxes[np.argsort(-scores, kind="stable")[:_STARTS]]
    starts = np.concatenate([common[None], turned[None], trusted])
    starts[:, YAW] = wrap_angle(2 * starts[:, YAW]) / 2
    if path.knows_front:
        starts = np.delete(starts, 1, axis=0)
        starts[:, YAW] = 0.0
    return starts


def _fitted(
    starts: Floats, own: Sequence[NDArray[np.bool_]], cloud: _Cloud, settings: LabellerSettings
) -> tuple[Floats, list[LossTerms]]:
    """The starts moved to the minimum of the paper's losses near them, size and heading frozen."""
    most = settings.points.sample_count
    problems = []
    for start, mask in zip(starts, own, strict=True):
        rows = np.flatnonzero(mask)
        rows = rows[:: -(-len(rows) // most)]
        problems.append(
            FitProblem(
                points_xz=cloud.points[rows][:, [0, 2]],
                length_m=float(start[LENGTH]),
                width_m=float(start[WIDTH]),
                rotation_y=float(start[YAW]),
                origin_xz=cloud.origins[rows][:, [0, 2]],
                start_xz=start[[X, Z]],
            )
        )
    solutions = fit_boxes(problems, settings.fit, settings.loss, most)
    moved_starts = starts.copy()
    moved_starts[:, [X, Z]] = [solution.center_xz for solution in solutions]
    return moved_starts, [solution.losses for solution in solutions]


def _target(
    cloud: _Cloud,
    own: Sequence[NDArray[np.bool_]],
    views: Sequence[Glimpse],
    path: Path,
    starts: Floats,
    size: SizePull,
    settings: LabellerSettings,
) -> tuple[Target, list[Viewpoint]]:
    """What the polish pulls to. Prompts err alike in all frames: the edges of all count as those of one."""
    more = len(views) ** _MORE
    bottom, is_known = _ground(views, path, float(starts[0, BOTTOM]))
    boxes_px = np.array([each.region.box_px for each in views])
    targets = []
    for mask, start in zip(own, starts, strict=True):
        points_xz = cloud.points[mask][:, [0, 2]]
        # Cells are as even as densities get.
        weights = np.full(len(points_xz), min(POINTS_WORTH / max(len(points_xz), 1), 1.0) * more)
        targets.append(
            Target.of_one(
                points_xz,
                weights,
                boxes_px,
                _seen_size(start, points_xz, size),
                np.array([bottom]),
                np.array([is_known]),
            )
        )
    use_edges = settings.repairs is None or settings.repairs.edges
    viewpoints = [
        Viewpoint(
            each.image_P_world @ path.world_SE3_object(each.sweep),
            each.view.frame.image_size_px,
            use_edges / len(views),
        )
        for each in views
    ]
    yaw_rad = _PATH_YAW_RAD if path.knows_front else YAW_RAD
    return replace(Target.joined(targets), inside_m=_INSIDE_M, yaw_rad=yaw_rad), viewpoints


def _seen_size(box: Floats, points_xz: Floats, size: SizePull) -> SizePull:
    """The pull of a class, and that of the points where they reach along most of its length: it ends there.

    Points of a side that is seen up to its end tell a length that no prior knows; where something hides the
    end, they tell one that is too short, the more so the less they show. Of people, who swing their arms and
    legs, they tell nothing.
    """
    length_m, _, height_m = (float(side) for side in size.lwh_m)
    along, _ = to_box_frame(box[None], points_xz)
    low, high = np.quantile(along[0], [_SPAN_TAIL, 1 - _SPAN_TAIL])
    span_m = float(high - low) + _SPAN_MORE_M
    if span_m < _SPAN_SHARE * length_m or height_m > length_m:
        return size
    span_sigma_m = _SPAN_SIGMA_M + _SPAN_HIDDEN * max(length_m - span_m, 0.0)
    own, seen = size.sigma_m[0] ** -2, span_sigma_m**-2
    lwh, sigma = size.lwh_m.copy(), size.sigma_m.copy()
    lwh[0] = (own * length_m + seen * span_m) / (own + seen)
    sigma[0] = (own + seen) ** -0.5
    return SizePull(lwh, sigma)


def _ground(views: Sequence[Glimpse], path: Path, bottom: float) -> tuple[float, bool]:
    """y of the ground under the object where frames saw it, else its bottom; and whether they did."""
    grounds = []
    for each in views:
        world_SE3_object = path.world_SE3_object(each.sweep)
        ground_world, is_known = each.ground_world(moved(world_SE3_object, np.array([0, bottom, 0])))
        if is_known:
            grounds.append(moved(inverse(world_SE3_object), ground_world)[1])
    return (float(np.median(grounds)), True) if grounds else (bottom, False)


def _evenly(views: Sequence[Glimpse], count: int) -> list[Glimpse]:
    if len(views) <= count:
        return list(views)
    return [views[row] for row in np.linspace(0, len(views) - 1, count).round().astype(int)]


def _weighted_median(values: Floats, weights: Floats) -> float:
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, total[-1] / 2)])
