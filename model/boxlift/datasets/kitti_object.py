"""One split of the KITTI object benchmark: velodyne/, calib/, image_2/, and label_2/ where it is labelled.

Source: the KITTI object development kit's readme (Geiger et al., CVPR 2012).
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

from boxlift.datasets.plain_folder import PlainFolder, stems_of
from boxlift.storage import is_folder

if TYPE_CHECKING:
    from boxlift.storage import AnyPath


class KittiObjectFolder(PlainFolder):
    """FrameSource for training/ or testing/: a plain folder whose frames are those of its calib/.

    A frame whose point cloud is missing is still a frame; loading it says what is missing.
    """

    layout = "KITTI object"

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all frames, sorted."""
        return stems_of(self._points, self._images, self._calibrations)


def recognise(root: AnyPath) -> KittiObjectFolder | None:
    """A root that holds training/ or testing/; of both, training/ (name ROOT/testing to have the other)."""
    for split in ("training", "testing"):
        if is_folder(root / split / "velodyne"):
            return KittiObjectFolder(root / split)
    return None
