"""What the LiDAR saw around the image, once per frame; and what of it one prompt is about."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Floats
from boxlift.consistency import cut_edges
from boxlift.frame import Frame
from boxlift.ground import Ground, find_ground
from boxlift.seeds import seed_of
from boxlift.settings import GroundSettings

# Points this share of the image's size beyond its border still count for an object that the border cuts.
_BEYOND_BORDER = 0.3
# Around a prompt, by this share of its width, lies what an object may continue into.
_SURROUNDINGS = 0.3
_NEAREST_M = 0.5
# Points lower than this above the ground may be ground.
_OFF_GROUND_M = 0.2
# Rays and points per prompt that the evidence looks at; more say nothing new.
_MAX_INSIDE, _MAX_AROUND = 160, 320

Indices = NDArray[np.intp]


@dataclass(frozen=True)
class View:
    """Points in and around the image: (N, 3) rectified camera frame, (N, 2) pixels, (N,) above ground."""

    frame: Frame
    ground: Ground
    points_cam: Floats
    pixels: Floats
    above_m: Floats

    @classmethod
    def of(cls, frame: Frame, settings: GroundSettings) -> View:
        """The points before the camera, in the image or beyond its border by no more than matters.

        The ground is fitted to those in the image, so that a sweep cropped to the view labels alike.
        """
        calibration = frame.calibration
        points_velo = frame.points_velo[:, :3]
        depth_m = points_velo @ calibration.cam_SE3_velo[2, :3].astype(points_velo.dtype)
        before = depth_m > _NEAREST_M - calibration.cam_SE3_velo[2, 3]
        points_cam = calibration.velo_to_cam(points_velo[before])
        pixels, depth_m = calibration.project(points_cam)
        columns, rows = pixels.T
        width, height = frame.image_size_px
        margin = _BEYOND_BORDER + 0.1
        near = (columns > -margin * width) & (columns < (1 + margin) * width) & (depth_m > 0)
        near &= (rows > -margin * height) & (rows < (1 + margin) * height)
        # Column by column in memory: every prompt compares whole columns.
        points_cam, pixels = np.asfortranarray(points_cam[near]), np.asfortranarray(pixels[near])
        columns, rows = pixels.T
        in_image = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        ground = find_ground(points_cam[in_image], frame.name, settings)
        return cls(frame, ground, points_cam, pixels, ground.height_above(points_cam))

    def within(self, low_px: Floats, high_px: Floats) -> NDArray[np.bool_]:
        """(N,) which points fall between two corners (2,) of the image, edges included."""
        columns, rows = self.pixels.T
        inside: NDArray[np.bool_] = (columns >= low_px[0]) & (columns <= high_px[0])
        inside &= (rows >= low_px[1]) & (rows <= high_px[1])
        return inside

    @property
    def sensor_cam(self) -> Floats:
        """(3,) where the rays start."""
        return self.frame.calibration.lidar_center_cam


@dataclass(frozen=True)
class Region:
    """What one prompt is about, as row numbers into the view.

    box_px: (4,) the prompt cut to the image. cut: (4,) edges x1, y1, x2, y2 that the border may cut.
    may_hide: whether the border or a nearer prompt may hide a part of the object.
    inside: (M,) a sample of the object-high points in the prompt, those claimed by nearer objects left
    out; a prompt that the border cuts goes on beyond it. inside_image: (M,) which of those the camera saw.
    around: (K,) likewise, the surroundings with it. around_inside: (K,) which of those lie in the prompt.
    in_prompt: points in it of any height. found, found_around: before sampling.
    """

    box_px: Floats
    cut: NDArray[np.bool_]
    may_hide: bool
    inside: Indices
    inside_image: NDArray[np.bool_]
    around: Indices
    around_inside: NDArray[np.bool_]
    in_prompt: int
    found: int
    found_around: int

    @property
    def width_px(self) -> float:
        """Of the prompt within the image."""
        return float(self.box_px[2] - self.box_px[0])


def region_of(view: View, index: int, claimed: NDArray[np.bool_], height_m: float) -> Region:
    """The region of prompt `index`; points up to `height_m` above the ground are object-high."""
    frame = view.frame
    size = np.array(frame.image_size_px, dtype=np.float64)
    prompt_px = np.array(frame.prompts[index].box_px)
    cut = cut_edges(prompt_px[None], frame.image_size_px)[0]
    box_px = np.clip(prompt_px, 0, np.tile(size - 1, 2))
    beyond = _BEYOND_BORDER * np.tile(size, 2) * cut * np.array([-1, 0, 1, 1])
    low, high = (box_px + beyond)[:2], (box_px + beyond)[2:]
    margin = _SURROUNDINGS * (box_px[2] - box_px[0])

    in_box = view.within(low, high)
    if frame.instance_ids is not None:
        in_box &= _on_mask(view, index)
    objects = (view.above_m > _OFF_GROUND_M) & (view.above_m < height_m) & ~claimed
    near = view.within(low - margin, high + margin)
    inside, around = np.flatnonzero(in_box & objects), np.flatnonzero(near & objects)
    rng = np.random.default_rng(seed_of(frame.name, index))
    found, found_around = len(inside), len(around)
    inside, around = _sample(inside, _MAX_INSIDE, rng), _sample(around, _MAX_AROUND, rng)
    columns, rows = view.pixels[inside].T
    inside_image = (columns >= 0) & (columns < size[0]) & (rows >= 0) & (rows < size[1])
    return Region(
        box_px=box_px,
        cut=cut,
        may_hide=bool(cut.any()) or _nearer_prompt_overlaps(frame, index),
        inside=inside,
        inside_image=inside_image,
        around=around,
        around_inside=in_box[around],
        in_prompt=int(in_box.sum()),
        found=found,
        found_around=found_around,
    )


def _sample(rows: Indices, count: int, rng: np.random.Generator) -> Indices:
    return rows if len(rows) <= count else np.sort(rng.choice(rows, count, replace=False))


def _on_mask(view: View, index: int) -> NDArray[np.bool_]:
    """(N,) which points fall onto the prompt's pixels; beyond the image there are none."""
    ids = view.frame.instance_ids
    assert ids is not None
    columns, rows = np.rint(view.pixels).astype(np.intp).T
    within = (columns >= 0) & (rows >= 0) & (columns < ids.shape[1]) & (rows < ids.shape[0])
    on_mask = np.zeros(len(columns), dtype=np.bool_)
    on_mask[within] = ids[rows[within], columns[within]] == index + 1
    return on_mask


def _nearer_prompt_overlaps(frame: Frame, index: int) -> bool:
    """Whether another prompt that reaches lower in the image, so is nearer, covers a part of this one."""
    x1, y1, x2, y2 = frame.prompts[index].box_px
    others = np.array([p.box_px for i, p in enumerate(frame.prompts) if i != index]).reshape(-1, 4)
    shared_x = np.minimum(others[:, 2], x2) - np.maximum(others[:, 0], x1)
    shared_y = np.minimum(others[:, 3], y2) - np.maximum(others[:, 1], y1)
    covers = (others[:, 3] > y2) & (shared_x > 0.1 * (x2 - x1)) & (shared_y > 0.3 * (y2 - y1))
    return bool(covers.any())
