"""What a source answers that has no annotations of its own and whose images are rectified."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxlift.errors import DatasetError
from boxlift.formats.kitti_label import KittiObject


class NoAnnotations:
    """A source whose labels all lie in folders of KITTI text files."""

    label_names: tuple[str, ...] = ()

    def objects(self, labels: str, name: str) -> list[KittiObject]:
        """See FrameSource.objects."""
        raise DatasetError(labels, f"frame {name!r} has no such annotations.", "Give a folder of labels.")


class RectifiedImages:
    """A source whose images lie on disk as its cameras are calibrated: without distortion."""

    def rectified_boxes(self, name: str, boxes_px: NDArray[np.float64]) -> NDArray[np.float64]:  # noqa: ARG002 - the same for all
        """See FrameSource.rectified_boxes."""
        return boxes_px
