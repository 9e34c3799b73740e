"""From a prompt to object-LiDAR-points (paper, section 3.1 and appendix 'Details of ...')."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Floats
from boxlift.extras import open3d
from boxlift.frame import Frame, PointCounts, Prompt, Result
from boxlift.ground import Ground
from boxlift.priors import SizePrior
from boxlift.seeds import seed_of
from boxlift.settings import ObjectPointSettings

# No image is as wide; a NaN is no edge either.
_LARGEST_PX = 1e6
# More points than this in one prompt are clustered through voxels; most objects have fewer.
_CROWD = 1000


@dataclass(frozen=True)
class VisiblePoints:
    """The points of a frame that fall into its image: (N, 3) rectified camera frame and (N, 2) pixels."""

    cam: Floats
    pixels: Floats


@dataclass(frozen=True)
class ObjectPoints:
    """The points of one prompt.

    cluster: (K, 3) the largest cluster, rectified camera frame. used: (M, 3) what the losses see.
    """

    prompt_index: int
    cluster: Floats
    used: Floats
    counts: PointCounts


@dataclass(frozen=True)
class UnusablePrompt:
    """A prompt without object points, and why."""

    prompt_index: int
    result: Result
    sentence: str
    counts: PointCounts = field(default_factory=PointCounts)


def points_in_image(frame: Frame) -> VisiblePoints:
    """The LiDAR points in front of the camera that project into the image."""
    points_cam = frame.calibration.velo_to_cam(frame.points_velo)
    points_cam = points_cam[points_cam[:, 2] > 0]
    pixels, depth_m = frame.calibration.project(points_cam)
    column_px, row_px = pixels.T
    width, height = frame.image_size_px
    inside = (depth_m > 0) & (column_px >= 0) & (column_px < width) & (row_px >= 0) & (row_px < height)
    return VisiblePoints(points_cam[inside], pixels[inside])


def select_object_points(
    frame: Frame,
    points: VisiblePoints,
    ground: Ground,
    settings: ObjectPointSettings,
    sizes: Mapping[str, SizePrior],
) -> list[ObjectPoints | UnusablePrompt]:
    """Object points of every prompt, in the order of the prompts."""
    return [
        check_prompt(prompt, index, frame.image_size_px, sizes)
        or _object_points(frame, points, ground, index, settings)
        for index, prompt in enumerate(frame.prompts)
    ]


def check_prompt(
    prompt: Prompt, index: int, image_size_px: tuple[int, int], sizes: Mapping[str, SizePrior]
) -> UnusablePrompt | None:
    """Why a prompt cannot be used whatever the points are, or None."""
    if prompt.category in sizes:
        return check_box(prompt, index, image_size_px)
    result = Result.UNKNOWN_CLASS
    sentence = result.value.format(category=prompt.category, known=", ".join(sorted(sizes)))
    return UnusablePrompt(index, result, sentence)


def check_box(prompt: Prompt, index: int, image_size_px: tuple[int, int]) -> UnusablePrompt | None:
    """Why the 2D box of a prompt cannot be used in an image of this size, or None."""
    x1, y1, x2, y2 = prompt.box_px
    width, height = image_size_px
    box = f"({x1:g}, {y1:g}, {x2:g}, {y2:g})"
    if not (np.abs(prompt.box_px).max() < _LARGEST_PX and x2 > x1 and y2 > y1):
        result = Result.BAD_BOX
        sentence = result.value.format(box=box)
    elif x2 <= 0 or y2 <= 0 or x1 >= width or y1 >= height:
        result = Result.BOX_OUTSIDE_IMAGE
        sentence = result.value.format(box=box, width=width, height=height)
    else:
        return None
    return UnusablePrompt(index, result, sentence)


def _object_points(
    frame: Frame, points: VisiblePoints, ground: Ground, index: int, settings: ObjectPointSettings
) -> ObjectPoints | UnusablePrompt:
    x1, y1, x2, y2 = frame.prompts[index].box_px
    column_px, row_px = points.pixels.T
    inside = (column_px >= x1) & (column_px <= x2) & (row_px >= y1) & (row_px <= y2)
    region = "box"
    if frame.instance_ids is not None:
        region = "mask"
        ids = frame.instance_ids
        around = ids[max(0, int(y1)) : math.ceil(y2) + 1, max(0, int(x1)) : math.ceil(x2) + 1]
        if not (around == index + 1).any():
            return UnusablePrompt(index, Result.EMPTY_MASK, Result.EMPTY_MASK.value)
        # Pixel (0, 0) is centred on the coordinates (0, 0).
        columns, rows = np.rint(points.pixels[inside]).astype(np.intp).T
        rows, columns = np.minimum(rows, ids.shape[0] - 1), np.minimum(columns, ids.shape[1] - 1)
        inside[inside] = ids[rows, columns] == index + 1
    initial = int(inside.sum())
    needed = settings.min_points
    if initial < needed:
        sentence = Result.TOO_FEW_POINTS.value.format(region=region, found=initial, needed=needed)
        return UnusablePrompt(index, Result.TOO_FEW_POINTS, sentence, PointCounts(in_prompt=initial))
    above_ground = points.cam[inside & ~ground.is_ground]
    cluster = above_ground[largest_cluster(above_ground, settings)]
    if len(cluster) < needed:
        counts = PointCounts(initial, len(above_ground), len(cluster))
        sentence = Result.TOO_FEW_OBJECT_POINTS.value.format(
            found=len(cluster), initial=initial, needed=needed
        )
        return UnusablePrompt(index, Result.TOO_FEW_OBJECT_POINTS, sentence, counts)
    rng = np.random.default_rng(seed_of(frame.name, index))
    used = sample(cluster[lower_half(cluster, settings)], settings, rng)
    counts = PointCounts(initial, len(above_ground), len(cluster), len(used))
    return ObjectPoints(index, cluster, used, counts)


def largest_cluster(points_cam: Floats, settings: ObjectPointSettings) -> NDArray[np.bool_]:
    """(N,) which of the (N, 3) points belong to the largest DBSCAN cluster (Ester et al., 1996; Open3D)."""
    if len(points_cam) == 0:
        return np.zeros(0, dtype=np.bool_)
    o3d = open3d()
    seen, represents = _thinned(points_cam, settings)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points_cam[seen]))
    labels = np.asarray(cloud.cluster_dbscan(settings.cluster_radius_m, settings.cluster_min_points))
    labels = labels[represents]
    sizes = np.bincount(labels[labels >= 0], minlength=1)
    largest: NDArray[np.bool_] = labels == int(sizes.argmax())
    return largest


def _thinned(points_cam: Floats, settings: ObjectPointSettings) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Which points to cluster (K,), and for every point (N,) which of those stands for it.

    DBSCAN holds every pair of neighbours: quadratic in a crowd, and minutes and gigabytes for a hostile
    one. There one point stands for its voxel, an eighth of the radius wide, or a quarter where even
    these are many. The size of a cluster still counts all points; what makes a point a core point counts
    voxels, which differs only where points lie closer than those are wide.
    """
    everything = np.arange(len(points_cam))
    seen, represents = everything, everything
    for voxels_per_radius in (8, 4):
        if len(seen) <= _CROWD:
            break
        voxels = np.floor(points_cam * (voxels_per_radius / settings.cluster_radius_m)).astype(np.int64)
        _, seen, represents = np.unique(voxels, axis=0, return_index=True, return_inverse=True)
    return seen, represents


def lower_half(cluster: Floats, settings: ObjectPointSettings) -> NDArray[np.bool_]:
    """(K,) which points of a cluster (K, 3) to keep: those at or below its middle height.

    y points down, so lower means a larger y. The points of the upper half lie inside the outline seen
    from above (bonnet, windscreen) and would pull the box.
    """
    y = cluster[:, 1]
    everything = np.ones(len(cluster), dtype=np.bool_)
    if settings.vertical_filter == "none":
        return everything
    middle = np.median(y) if settings.vertical_filter == "median" else (y.min() + y.max()) / 2
    kept: NDArray[np.bool_] = y >= middle
    return kept if kept.sum() >= settings.vertical_filter_min_points else everything


def sample(points_cam: Floats, settings: ObjectPointSettings, rng: np.random.Generator) -> Floats:
    """At most `sample_count` of the points (M, 3) at random; all of them, in order, where there are fewer."""
    count = settings.sample_count
    if settings.sample_with_replacement:
        return points_cam[rng.integers(len(points_cam), size=count)]
    if len(points_cam) <= count:
        return points_cam
    return points_cam[np.sort(rng.choice(len(points_cam), size=count, replace=False))]
