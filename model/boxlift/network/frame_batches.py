"""Training frames in batches: decoded ahead of time, changed at random, padded to one size."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from boxlift.camera import Floats
from boxlift.network.augmentation import Sample, augment
from boxlift.network.backbones import MULTIPLE
from boxlift.network.batch import FrameBatch, Images, ObjectBatch
from boxlift.network.config import AugmentationSettings
from boxlift.network.frozen_maps import FrozenMaps
from boxlift.network.targets import frozen_sizes
from boxlift.network.training_frames import TrainingFrame

Item = TypeVar("Item")
Made = TypeVar("Made")

# Batches that are decoded while one is trained on.
_AHEAD = 2


class FrameBatches:
    """Batches of `batch_size` frames; the last one of an epoch may be smaller."""

    def __init__(
        self,
        frames: Sequence[TrainingFrame],
        categories: Sequence[str],
        batch_size: int,
        augmentation: AugmentationSettings,
        *,
        rays_from_lidar: bool = False,
        threads: int = 1,
    ) -> None:
        """With `augmentation` all zero, frozen maps can take the place of images: see shuffled."""
        self._frames = frames
        self._frozen_sizes = frozen_sizes(categories)
        self._batch_size = batch_size
        self._augmentation = augmentation
        self._rays_from_lidar = rays_from_lidar
        self._threads = threads

    def shuffled(
        self, generator: torch.Generator, frozen_maps: FrozenMaps | None = None
    ) -> Iterator[FrameBatch]:
        """All frames once in random order, each changed by random numbers of its own.

        With `frozen_maps` batches hold those in place of images, and frames stay as they are.
        """
        order = torch.randperm(len(self._frames), generator=generator).tolist()
        seeds = torch.randint(2**62, (len(order),), generator=generator).tolist()
        groups = [
            list(zip(order[start : start + self._batch_size], seeds[start:], strict=False))
            for start in range(0, len(order), self._batch_size)
        ]
        if frozen_maps is not None:
            for group in groups:
                frames = [self._frames[index] for index, _ in group]
                samples = [unchanged(frame, with_image=False) for frame in frames]
                yield self._batch(samples, frozen_maps.of(frames))
            return
        with ThreadPoolExecutor(self._threads) as threads:
            for samples in _ahead(threads, self._sample, groups):
                yield self._batch(samples, stacked_images([sample.image for sample in samples]))

    def _batch(self, samples: Sequence[Sample], images: Images) -> FrameBatch:
        return batch_of(samples, images, self._frozen_sizes, rays_from_lidar=self._rays_from_lidar)

    def _sample(self, choice: tuple[int, int]) -> Sample:
        index, seed = choice
        return augment(unchanged(self._frames[index]), self._augmentation, np.random.default_rng(seed))


def stacked_images(images: Sequence[NDArray[np.uint8]]) -> Tensor:
    """Images (H, W, 3) of any sizes -> (B, 3, H, W) float, black below and right of the smaller ones."""
    height, width = (max(image.shape[axis] for image in images) for axis in (0, 1))
    stacked = torch.zeros(len(images), 3, height + -height % MULTIPLE, width + -width % MULTIPLE)
    for place, image in zip(stacked, images, strict=True):
        rows, columns = image.shape[:2]
        place[:, :rows, :columns] = torch.from_numpy(image).permute(2, 0, 1)
    return stacked


def batch_of(
    samples: Sequence[Sample], images: Images, frozen_sizes: Floats, *, rays_from_lidar: bool
) -> FrameBatch:
    """Samples and their stacked images, or maps -> a batch. frozen_sizes (classes, 3)."""
    counts = [len(sample.boxes_px) for sample in samples]
    category = torch.from_numpy(np.concatenate([sample.category for sample in samples]))
    targets = [sample.targets for sample in samples]
    points_cam = _joined(t.points_cam for t in targets)
    point_count = torch.from_numpy(np.concatenate([t.point_count for t in targets]))
    origins = np.stack(
        [s.lidar_center_cam if rays_from_lidar else _camera_center(s.image_P_cam) for s in samples]
    )
    return FrameBatch(
        images=images,
        image_P_cam=torch.from_numpy(np.stack([sample.image_P_cam for sample in samples])).float(),
        object_counts=counts,
        objects=ObjectBatch(
            boxes_px=_joined(sample.boxes_px for sample in samples),
            category=category,
            frozen_size_m=torch.from_numpy(frozen_sizes).float()[category],
            weight=_joined(t.weight for t in targets),
            points_cam=points_cam,
            is_point=torch.arange(points_cam.shape[1]) < point_count[:, None],
            heading=_joined(t.heading for t in targets),
            origin_xz=torch.from_numpy(np.repeat(origins[:, [0, 2]], counts, axis=0)).float(),
            center_cam=_joined(t.center_cam for t in targets),
            size_m=_joined(t.size_m for t in targets),
            rotation_y=_joined(t.rotation_y for t in targets),
        ),
    )


def unchanged(frame: TrainingFrame, *, with_image: bool = True) -> Sample:
    """A frame with its pixels, or without any."""
    return Sample(
        image=frame.read_image() if with_image else np.empty((0, 0, 3), dtype=np.uint8),
        image_P_cam=frame.image_P_cam,
        lidar_center_cam=frame.lidar_center_cam,
        boxes_px=frame.boxes_px,
        category=frame.category,
        targets=frame.targets,
    )


def _camera_center(image_P_cam: Floats) -> Floats:
    center: Floats = np.negative(np.linalg.solve(image_P_cam[:, :3], image_P_cam[:, 3]))
    return center


def _joined(arrays: Iterable[Floats]) -> Tensor:
    return torch.from_numpy(np.concatenate(list(arrays))).float()


def _ahead(
    threads: ThreadPoolExecutor, make: Callable[[Item], Made], groups: Iterable[Sequence[Item]]
) -> Iterator[list[Made]]:
    """make(item) of every group's items, in order; the next groups are made while one is used."""
    waiting: deque[list[Future[Made]]] = deque()
    for group in groups:
        waiting.append([threads.submit(make, item) for item in group])
        if len(waiting) > _AHEAD:
            yield [future.result() for future in waiting.popleft()]
    for futures in waiting:
        yield [future.result() for future in futures]
