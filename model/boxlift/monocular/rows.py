"""From a row of the model's answer to a label, or to the sentence why it is none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boxlift.boxes import Boxes3D
from boxlift.confidence import share_of
from boxlift.consistency import cut_edges
from boxlift.frame import ObjectLabel, Prompt, Result

# Farther than any camera sees a road user; longer than any of them.
_FARTHEST_M, _LONGEST_M = 10_000.0, 100.0
# Beyond this relative standard deviation of the depth, a box 30 m away is as likely as not 2 m off.
_UNCERTAIN_DEPTH = 0.1


@dataclass(frozen=True)
class Rows:
    """The outputs of the interface MONOCULAR, M rows; boxes in pixels of the original image.

    image_size_px: (width, height) of that image. knows_front: whether rotations tell front from back.
    """

    boxes_px: NDArray[np.floating]
    categories: NDArray[np.int64]
    detection_scores: NDArray[np.floating]
    centers_cam: NDArray[np.floating]
    sizes_m: NDArray[np.floating]
    rotations_y: NDArray[np.floating]
    depth_spread: NDArray[np.floating]
    scores: NDArray[np.floating]
    image_size_px: tuple[int, int]
    knows_front: bool

    def __len__(self) -> int:
        return len(self.scores)


def label_of_row(rows: Rows, row: int, index: int, prompt: Prompt, weight: float = 1.0) -> ObjectLabel:
    """The label number `index` of a frame, for `prompt`, from one row; absurd numbers give no box.

    The score of the row is multiplied by `weight`, cut to [0, 1].
    """
    if (reason := _absurdity(rows, row)) is not None:
        result = Result.ABSURD_PREDICTION
        return ObjectLabel(index, prompt, result, result.value.format(reason=reason))
    length_m, width_m, height_m = rows.sizes_m[row].astype(np.float64)
    box = Boxes3D(rows.centers_cam[row], length_m, width_m, height_m, rows.rotations_y[row])
    depth_spread = float(rows.depth_spread[row])
    named = {
        "heading_ambiguous": not rows.knows_front,
        "truncated": bool(cut_edges(np.array([prompt.box_px]), rows.image_size_px).any()),
        "depth_uncertain": depth_spread > _UNCERTAIN_DEPTH,
    }
    return ObjectLabel(
        index,
        prompt,
        Result.PREDICTED,
        Result.PREDICTED.value,
        box,
        score=share_of(float(rows.scores[row])) * share_of(weight),
        flags=tuple(name for name, holds in named.items() if holds),
        depth_spread=depth_spread,
    )


def _absurdity(rows: Rows, row: int) -> str | None:
    """Why the numbers of a row are no object, or None."""
    center, size_m = rows.centers_cam[row], rows.sizes_m[row]
    numbers: dict[str, Any] = {
        "2D box": rows.boxes_px[row],
        "centre": center,
        "size": size_m,
        "rotation": rows.rotations_y[row],
        "spread of depth": rows.depth_spread[row],
        "score": rows.scores[row],
    }
    for what, values in numbers.items():
        if not np.isfinite(values).all():
            return f"its {what} is not finite"
    if not (size_m.min() > 0 and size_m.max() < _LONGEST_M):
        return f"its size is {' x '.join(f'{side:.3g}' for side in size_m)} m"
    if not (center[2] > 0 and np.abs(center).max() < _FARTHEST_M):
        return f"its centre is at {', '.join(f'{axis:.3g}' for axis in center)} m"
    return None
