"""What a source answers that has no annotations of its own."""

from __future__ import annotations

from boxlift.errors import DatasetError
from boxlift.formats.kitti_label import KittiObject


class NoAnnotations:
    """A source whose labels all lie in folders of KITTI text files."""

    label_names: tuple[str, ...] = ()

    def objects(self, labels: str, name: str) -> list[KittiObject]:
        """See FrameSource.objects."""
        raise DatasetError(labels, f"frame {name!r} has no such annotations.", "Give a folder of labels.")
