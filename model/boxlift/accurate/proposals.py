"""Where an object might be: clusters of its points x headings x placements, and the prompt alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxlift.accurate.parameters import YAW, X, Z
from boxlift.accurate.view import Indices, Region, View
from boxlift.camera import Floats
from boxlift.extras import open3d
from boxlift.settings import RepairSettings

# DBSCAN's radius grows with the range: beams diverge (ours; near cars that touch stay apart).
_RADIUS_M, _RADIUS_PER_M, _RADIUS_LIMITS_M = 0.35, 0.008, (0.2, 1.0)
# Heights count half: beams lie further apart vertically than horizontally.
_VERTICAL_SCALE = 0.5
_CORE_POINTS = 3
_CROWD = 600
# Pairs of points this far apart tell directions; nearer ones tell noise, farther ones another face.
_PAIR_M = (0.3, 3.5)
_DIRECTION_BINS = 36
_CLOSENESS_STEPS = 45
_CLOSENESS_FLOOR_M = 0.05
_SAME_DIRECTION_RAD = 0.08
# This share of the points at either end does not count for their extent.
_OUTERMOST = 0.03
_SLACK_M = 0.4
# Proposals nearer to each other than this are one.
_GRAIN = np.array([0.3, 0.3, 0.1])
_QUARTER = np.pi / 2


@dataclass(frozen=True)
class Cluster:
    """Points of a region that hang together, as rows of the view, and how much it looks like the object."""

    rows: Indices
    likeness: float


def find_clusters(view: View, region: Region, settings: RepairSettings) -> list[Cluster]:
    """The likeliest clusters of a prompt, best first.

    Likeness is how much of the prompt's width a cluster spans, times how much of it lies in the prompt
    (an occluder or a wall goes on outside), times a share of the prompt's points.
    """
    rows = region.around
    is_inside = region.around_inside
    if is_inside.sum() < _CORE_POINTS:
        return []
    points = view.points_cam[rows] * np.array([1.0, _VERTICAL_SCALE, 1.0])
    range_m = float(np.median(np.hypot(points[is_inside, 0], points[is_inside, 2])))
    likeliest: dict[bytes, Cluster] = {}
    for scale in settings.cluster_scales:
        radius_m = float(np.clip((_RADIUS_M + _RADIUS_PER_M * range_m) * scale, *_RADIUS_LIMITS_M))
        labels = _dbscan(points, radius_m)
        for label in range(labels.max() + 1):
            member = labels == label
            inside = rows[member & is_inside]
            if len(inside) < _CORE_POINTS:
                continue
            left, right = _extent(view.pixels[inside, 0])
            span = (right - left) / max(region.width_px, 1.0)
            share = len(inside) / is_inside.sum()
            likeness = span * (len(inside) / member.sum()) * np.sqrt(min(1.0, 2 * share))
            known = likeliest.get(inside.tobytes())
            if known is None or known.likeness < likeness:
                likeliest[inside.tobytes()] = Cluster(inside, float(likeness))
    ordered = sorted(likeliest.values(), key=lambda cluster: -cluster.likeness)
    return ordered[: settings.max_clusters]


def _dbscan(points: Floats, radius_m: float) -> NDArray[np.intp]:
    o3d = open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    return np.asarray(cloud.cluster_dbscan(radius_m, _CORE_POINTS), dtype=np.intp)


def lower_half(view: View, rows: Indices) -> Floats:
    """(M, 2) x, z of the lower half of some points (paper, appendix), all of them where they are few."""
    above = view.above_m[rows]
    kept = rows[above <= np.median(above)] if len(rows) >= 10 else rows
    lower: Floats = view.points_cam[kept][:, [0, 2]]
    return lower


def propose(
    view: View,
    region: Region,
    clusters: list[Cluster],
    lwh_m: Floats,
    sample_count: int,
    settings: RepairSettings,
) -> Floats:
    """(B, 7) boxes of a size (3,) worth a look: from the clusters, and from the prompt alone where set."""
    sensor_xz = view.sensor_cam[[0, 2]]
    places: list[tuple[float, float, float]] = []
    for cluster in clusters:
        points_xz = lower_half(view, cluster.rows)
        points_xz = points_xz[:: -(-len(points_xz) // sample_count)]
        for direction in main_directions(points_xz, settings.closeness):
            for yaw in (direction, direction + _QUARTER) if settings.perpendicular else (direction,):
                places += _placements(points_xz, yaw, lwh_m, sensor_xz, either_end=region.may_hide)
    if settings.prompt_placement:
        places += _from_prompt(view, region, float(lwh_m[2]))
    if not places:
        return np.empty((0, 7))
    placed = distinct(np.array(places))
    bottom = view.ground.y_at(placed[:, X], placed[:, Z])
    return np.concatenate([placed, np.tile(lwh_m, (len(placed), 1)), bottom[:, None]], axis=1)


def distinct(boxes: Floats) -> Floats:
    """(B, 3+) rows x, z, heading, ... -> those that differ from all rows before them, in their order."""
    _, first = np.unique(np.rint(boxes[:, : YAW + 1] / _GRAIN), axis=0, return_index=True)
    kept: Floats = boxes[np.sort(first)]
    return kept


def main_directions(points_xz: Floats, closeness: bool) -> list[float]:
    """Headings modulo a quarter turn: the mode of the pair directions (paper, equation 7), and the best
    L shape by closeness (Zhang et al., "Efficient L-shape fitting", IV 2017) where it differs."""
    first, second = np.triu_indices(len(points_xz), k=1)
    step = points_xz[first] - points_xz[second]
    length = np.hypot(step[:, 0], step[:, 1])
    step = step[(length > _PAIR_M[0]) & (length < _PAIR_M[1])]
    angles = np.arctan2(-step[:, 1], step[:, 0]) % _QUARTER
    member = (angles / _QUARTER * _DIRECTION_BINS).astype(np.intp) % _DIRECTION_BINS
    histogram = np.bincount(member, minlength=_DIRECTION_BINS).astype(np.float64)
    histogram += (np.roll(histogram, 1) + np.roll(histogram, -1)) / 2
    mode = (int(histogram.argmax()) + 0.5) * _QUARTER / _DIRECTION_BINS
    off = (angles - mode + _QUARTER / 2) % _QUARTER - _QUARTER / 2
    near = np.abs(off) < 0.1
    mode += float(off[near].mean()) if near.any() else 0.0
    if not closeness:
        return [mode]
    shape = _closest_l_shape(points_xz)
    apart = abs((shape - mode + _QUARTER / 2) % _QUARTER - _QUARTER / 2)
    return [mode, shape] if apart > _SAME_DIRECTION_RAD else [mode]


def _closest_l_shape(points_xz: Floats) -> float:
    angles = np.arange(_CLOSENESS_STEPS) * _QUARTER / _CLOSENESS_STEPS
    cos, sin = np.cos(angles)[:, None], np.sin(angles)[:, None]
    x, z = points_xz.T
    along, across = (
        np.minimum(axis - axis.min(1, keepdims=True), axis.max(1, keepdims=True) - axis)
        for axis in (cos * x - sin * z, sin * x + cos * z)
    )
    closeness = (1 / np.minimum(along, across).clip(_CLOSENESS_FLOOR_M)).mean(1)
    return float(angles[closeness.argmax()])


def _placements(
    points_xz: Floats, yaw: float, size: Floats, sensor_xz: Floats, *, either_end: bool
) -> list[tuple[float, float, float]]:
    """Centres (x, z) with the heading, for which the box touches the points with its near sides.

    Where the points reach further than the box, or what they lack may be hidden, it may be at either end
    of them; where the sensor looks along a side, it is in the middle.
    """
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn = np.array([[cos, -sin], [sin, cos]])
    axes, sensor = turn @ points_xz.T, turn @ sensor_xz
    options: list[tuple[float, ...]] = []
    for axis, from_side, side in zip(axes, sensor, size[:2], strict=True):
        low, high = _extent(axis)
        extent, middle = high - low, (low + high) / 2
        at_low, at_high = low + side / 2, high - side / 2
        if extent > side + _SLACK_M or (either_end and extent < side - _SLACK_M):
            options.append((at_low, at_high))
        elif abs(from_side - middle) > side / 2:
            options.append((at_low if from_side < middle else at_high,))
        else:
            options.append((middle,))
    return [
        (float(cos * along + sin * across), float(-sin * along + cos * across), yaw)
        for along in options[0]
        for across in options[1]
    ]


def _extent(values: Floats) -> tuple[float, float]:
    """From which value to which (M,) reach, but for the outermost few."""
    ordered = np.sort(values)
    outermost = round(_OUTERMOST * (len(ordered) - 1))
    return float(ordered[outermost]), float(ordered[-1 - outermost])


def _from_prompt(view: View, region: Region, height_m: float) -> list[tuple[float, float, float]]:
    """Where a box of the class's height fills the prompt, along and across the viewing direction."""
    image_P_cam = view.frame.calibration.image_P_cam
    left, top, right, bottom = region.box_px
    # Half a car lies behind the face that fills the prompt.
    depth_m = image_P_cam[1, 1] * height_m / max(bottom - top, 1.0) + 1.0
    x_m = ((left + right) / 2 - image_P_cam[0, 2]) * depth_m / image_P_cam[0, 0]
    return [(float(x_m), float(depth_m), _QUARTER), (float(x_m), float(depth_m), 0.0)]
