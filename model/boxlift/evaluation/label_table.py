"""The labels of many frames as one struct of arrays: what the metrics compute on."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from boxlift.boxes import Boxes3D
from boxlift.camera import Floats
from boxlift.errors import DatasetError
from boxlift.evaluation.rules import Difficulty
from boxlift.formats import kitti_label
from boxlift.formats.kitti_label import UNKNOWN_ANGLE, KittiObject
from boxlift.overlap import area_2d, intersection_2d

if TYPE_CHECKING:
    from boxlift.storage import AnyPath

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

_NAMES_IN_ERROR = 3


@dataclass(frozen=True)
class LabelTable:
    """N labels of F frames, in the order of the frames and of the lines in their files.

    frame: (N,) index of the frame, ascending. category: (N,) lower case, as KITTI compares them.
    truncated, occluded: (N,). alpha: (N,) radians, -10 where unknown. box_px: (N, 4).
    boxes: N boxes; has_box3d: (N,) False where a line holds the format's placeholders.
    score: (N,), 1 where the file has none.
    """

    frame_count: int
    frame: Indices
    category: NDArray[np.str_]
    truncated: Floats
    occluded: Floats
    alpha: Floats
    box_px: Floats
    boxes: Boxes3D
    has_box3d: Mask
    score: Floats

    def __len__(self) -> int:
        return len(self.frame)

    @classmethod
    def from_frames(cls, frames: Iterable[Sequence[KittiObject]]) -> LabelTable:
        """One sequence of objects per frame."""
        per_frame = list(frames)
        objects = [label for labels in per_frame for label in labels]
        return cls(
            frame_count=len(per_frame),
            frame=np.repeat(np.arange(len(per_frame)), [len(labels) for labels in per_frame]),
            category=np.array([label.category.lower() for label in objects], dtype=np.str_),
            truncated=np.array([label.truncated for label in objects], dtype=np.float64),
            occluded=np.array([label.occluded for label in objects], dtype=np.float64),
            alpha=np.array([label.alpha for label in objects], dtype=np.float64),
            box_px=np.array([label.box_px for label in objects], dtype=np.float64).reshape(-1, 4),
            boxes=kitti_label.boxes3d_of(objects),
            has_box3d=np.array([label.has_box3d for label in objects], dtype=np.bool_),
            score=np.array([1.0 if label.score is None else label.score for label in objects]),
        )

    def rows(self, mask: Mask) -> LabelTable:
        """The labels where `mask` (N,) holds."""
        return LabelTable(
            frame_count=self.frame_count,
            frame=self.frame[mask],
            category=self.category[mask],
            truncated=self.truncated[mask],
            occluded=self.occluded[mask],
            alpha=self.alpha[mask],
            box_px=self.box_px[mask],
            boxes=self.boxes[mask],
            has_box3d=self.has_box3d[mask],
            score=self.score[mask],
        )

    @cached_property
    def height_px(self) -> Floats:
        """(N,) heights of the image boxes."""
        height: Floats = self.box_px[:, 3] - self.box_px[:, 1]
        return height

    @cached_property
    def has_heading(self) -> Mask:
        """(N,) whether alpha is known."""
        known: Mask = self.alpha != UNKNOWN_ANGLE
        return known

    def counts_as(self, difficulty: Difficulty) -> Mask:
        """(N,) the truths that a difficulty counts."""
        return (
            (self.occluded <= difficulty.max_occluded)
            & (self.truncated <= difficulty.max_truncated)
            & (self.height_px > difficulty.min_height_px)
        )

    def is_any_of(self, categories: Sequence[str]) -> Mask:
        """(N,) whether a label is of one of the classes, whatever its case."""
        return np.isin(self.category, [category.lower() for category in categories])


def read_table(folder: AnyPath, frames: Sequence[str]) -> LabelTable:
    """Read `folder`/STEM.txt for every frame; raises DatasetError where some are not there."""
    missing = [name for name in frames if not (folder / f"{name}.txt").is_file()]
    if missing:
        named = ", ".join(missing[:_NAMES_IN_ERROR]) + (", ..." if len(missing) > _NAMES_IN_ERROR else "")
        raise DatasetError(
            str(folder),
            f"{len(missing)} of {len(frames)} frames have no label file ({named}).",
            "Write a file for every frame, empty where nothing was found, or list the frames to judge.",
        )
    return LabelTable.from_frames(kitti_label.read_file(folder / f"{name}.txt") for name in frames)


def pairs_in_frames(first: LabelTable, second: LabelTable) -> tuple[Indices, Indices]:
    """Every pair of labels that share a frame: (P,) indices into `first` and into `second`."""
    starts = np.searchsorted(second.frame, np.arange(second.frame_count + 1))
    partners = np.diff(starts)[first.frame]
    rows = np.repeat(np.arange(len(first)), partners)
    before = np.repeat(np.cumsum(partners) - partners, partners)
    return rows, np.arange(len(rows)) - before + starts[first.frame][rows]


def covered_by(labels: LabelTable, areas: LabelTable) -> Floats:
    """(N,) largest part of each label's image box that one box of `areas` in its frame covers."""
    rows, columns = pairs_in_frames(labels, areas)
    own_px = area_2d(labels.box_px)[rows]
    shared_px = intersection_2d(labels.box_px[rows], areas.box_px[columns])
    part = np.divide(shared_px, own_px, out=np.zeros_like(own_px), where=own_px > 0)
    largest = np.zeros(len(labels))
    np.maximum.at(largest, rows, part)
    return largest
