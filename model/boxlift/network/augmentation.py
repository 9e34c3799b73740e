"""Changes of a training frame that keep image and geometry in step: mirror, focal length, zoom, colour.

Image, projection, 2D boxes, points and boxes move together. `flip`, `focal` and `color` are exact: what is
projected afterwards lands where the pixels went. `scale` is exact for the centres of objects; around them
perspective changes a little, as it does when a real object comes nearer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional

from boxlift.camera import Floats
from boxlift.network.config import AugmentationSettings
from boxlift.network.targets import Targets

# Rec. 601 luma, as JPEG has it.
_LUMA = np.array([0.299, 0.587, 0.114], dtype=np.float32)
_MIRROR = np.array([-1.0, 1, 1])
# An object of which a zoom leaves less than this share of its 2D box is not learned from (ours).
_SMALLEST_SHARE = 0.3


@dataclass(frozen=True)
class Sample:
    """A training frame with its pixels: image (H, W, 3) uint8 RGB; the rest as in TrainingFrame."""

    image: NDArray[np.uint8]
    image_P_cam: Floats
    lidar_center_cam: Floats
    boxes_px: Floats
    category: NDArray[np.int64]
    targets: Targets


def augment(sample: Sample, settings: AugmentationSettings, rng: np.random.Generator) -> Sample:
    """A sample changed at random, as the settings say. The same generator state gives the same sample."""
    # All numbers are drawn first, so that switching one change off leaves the others as they were.
    mirrored = rng.random() < settings.flip
    focal, zoom = (1 + share * rng.uniform(-1, 1) for share in (settings.focal, settings.scale))
    brightness, contrast, saturation = 1 + settings.color * rng.uniform(-1, 1, 3)
    if mirrored:
        sample = flip(sample)
    if settings.focal:
        sample = change_focal(sample, focal)
    if settings.scale:
        sample = change_scale(sample, zoom)
    if settings.color:
        sample = replace(sample, image=recolor(sample.image, brightness, contrast, saturation))
    return sample


def flip(sample: Sample) -> Sample:
    """The mirrored scene: x becomes -x, pixel u becomes W - 1 - u, a heading r becomes pi - r."""
    last_px = sample.image.shape[1] - 1
    in_image = np.array([[-1.0, 0, last_px], [0, 1, 0], [0, 0, 1]])
    x1, y1, x2, y2 = sample.boxes_px.T
    targets = sample.targets
    return replace(
        sample,
        image=np.ascontiguousarray(sample.image[:, ::-1]),
        image_P_cam=in_image @ sample.image_P_cam @ np.diag([*_MIRROR, 1.0]),
        lidar_center_cam=sample.lidar_center_cam * _MIRROR,
        boxes_px=np.stack([last_px - x2, y1, last_px - x1, y2], axis=1),
        targets=replace(
            targets,
            points_cam=targets.points_cam * _MIRROR,
            heading=np.pi - targets.heading,
            center_cam=targets.center_cam * _MIRROR,
            rotation_y=np.pi - targets.rotation_y,
        ),
    )


def change_focal(sample: Sample, factor: float) -> Sample:
    """The same scene through a lens of `factor` times the focal length: the image resized, nothing moved."""
    height, width = sample.image.shape[:2]
    size = max(1, round(width * factor)), max(1, round(height * factor))
    in_image = _resizing(size[0] / width, size[1] / height)
    return replace(
        sample,
        image=_resized(sample.image, size),
        image_P_cam=in_image @ sample.image_P_cam,
        boxes_px=_moved_boxes(sample.boxes_px, in_image),
    )


def change_scale(sample: Sample, factor: float) -> Sample:
    """A zoom by `factor` around the principal point, taken for a shorter way: depths become 1 / factor.

    The image keeps its size: what a larger one loses at its borders is cut off, a smaller one is surrounded
    by black. Every object moves as a whole along z, to where it appears as large as it does now, and turns
    with the ray to it, so that it shows the same sides. 2D boxes are cut at the border; what has left the
    image weighs nothing any more.
    """
    height, width = sample.image.shape[:2]
    size = max(1, round(width * factor)), max(1, round(height * factor))
    across, down = size[0] / width, size[1] / height
    # By whole pixels, so that the picture is interpolated only once.
    shift_px = np.rint(sample.image_P_cam[:2, 2] * (1 - np.array([across, down]))).astype(int)
    in_image = np.array([[1.0, 0, shift_px[0]], [0, 1, shift_px[1]], [0, 0, 1]]) @ _resizing(across, down)
    boxes_px = _moved_boxes(sample.boxes_px, in_image)
    cut_px = boxes_px.clip(0, np.array([width, height, width, height]) - 1)
    gone = _area(cut_px) < _SMALLEST_SHARE * _area(boxes_px)
    moved = _come_nearer(sample.targets, across, sample.image_P_cam[2, 3])
    # z = across * (z' + t) - t, put into the projection of the resized image.
    P = in_image @ sample.image_P_cam
    last = (P[:, 3] + (across - 1) * P[2, 3] * P[:, 2]) / across
    return replace(
        sample,
        image=_placed(_resized(sample.image, size), (width, height), (int(shift_px[0]), int(shift_px[1]))),
        image_P_cam=np.stack([P[:, 0] / across, P[:, 1] / across, P[:, 2], last], axis=1),
        boxes_px=np.where(gone[:, None], boxes_px, cut_px),
        targets=replace(moved, weight=np.where(gone, 0.0, moved.weight)),
    )


def _come_nearer(targets: Targets, factor: float, offset_m: float) -> Targets:
    """Objects at 1 / factor of their depth, which is z + offset_m, turned with the ray to them.

    An object turns about its centre; where it has points and no box, about their mean.
    """
    real = np.arange(targets.points_cam.shape[1]) < targets.point_count[:, None]
    mean = (targets.points_cam * real[..., None]).sum(1) / targets.point_count[:, None].clip(1)
    pivot = np.where(targets.point_count[:, None] > 0, mean, targets.center_cam)
    there = pivot.copy()
    there[:, 2] = (pivot[:, 2] + offset_m) / factor - offset_m
    turn = np.arctan2(there[:, 0], there[:, 2]) - np.arctan2(pivot[:, 0], pivot[:, 2])
    cos, sin, zero = np.cos(turn), np.sin(turn), np.zeros_like(turn)
    rotation = np.array([[cos, zero, sin], [zero, zero + 1, zero], [-sin, zero, cos]])
    turned = np.einsum("ijn,nmj->nmi", rotation, targets.points_cam - pivot[:, None])
    return replace(
        targets,
        points_cam=turned + there[:, None],
        heading=targets.heading + turn,
        center_cam=targets.center_cam + there - pivot,
        rotation_y=targets.rotation_y + turn,
    )


def recolor(
    image: NDArray[np.uint8], brightness: float, contrast: float, saturation: float
) -> NDArray[np.uint8]:
    """(H, W, 3) with brightness, then contrast around its mean, then saturation times these factors."""
    pixels = image.astype(np.float32) * brightness
    pixels = pixels.mean() + (pixels - pixels.mean()) * contrast
    gray = pixels @ _LUMA
    pixels = gray[..., None] + (pixels - gray[..., None]) * saturation
    return np.asarray(pixels.round().clip(0, 255), dtype=np.uint8)


def _resizing(across: float, down: float) -> Floats:
    """(3, 3) pixels -> pixels of the resized image; half a pixel more, since pixel 0 is centred on 0."""
    return np.array([[across, 0, (across - 1) / 2], [0, down, (down - 1) / 2], [0, 0, 1]])


def _area(boxes_px: Floats) -> Floats:
    area: Floats = (boxes_px[:, 2:] - boxes_px[:, :2]).clip(0).prod(axis=1)
    return area


def _moved_boxes(boxes_px: Floats, in_image: Floats) -> Floats:
    scale, shift = np.diag(in_image)[:2], in_image[:2, 2]
    moved: Floats = boxes_px * np.tile(scale, 2) + np.tile(shift, 2)
    return moved


def _resized(image: NDArray[np.uint8], size_px: tuple[int, int]) -> NDArray[np.uint8]:
    """Bilinear, averaged where it shrinks. size_px: (width, height)."""
    pixels = torch.from_numpy(image).permute(2, 0, 1)[None].float()
    resized = functional.interpolate(
        pixels, size=(size_px[1], size_px[0]), mode="bilinear", align_corners=False, antialias=True
    )
    return resized[0].permute(1, 2, 0).round().clamp(0, 255).to(torch.uint8).numpy()


def _placed(
    image: NDArray[np.uint8], size_px: tuple[int, int], shift_px: tuple[int, int]
) -> NDArray[np.uint8]:
    """The image at a whole shift within a black one of `size_px`; what falls outside is cut off."""
    canvas = np.zeros((size_px[1], size_px[0], 3), dtype=np.uint8)
    (width, height), (x, y) = size_px, shift_px
    rows = slice(max(0, y), min(height, y + image.shape[0]))
    columns = slice(max(0, x), min(width, x + image.shape[1]))
    canvas[rows, columns] = image[rows.start - y : rows.stop - y, columns.start - x : columns.stop - x]
    return canvas
