"""What every dataset layout offers, and how a folder's layout is told."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from boxlift.datasets.kitti_object import KittiObjectFolder
from boxlift.datasets.plain_folder import PlainFolder
from boxlift.errors import DatasetError
from boxlift.formats import kitti_label
from boxlift.formats.kitti_label import KittiObject
from boxlift.frame import Frame, Prompt


class Source(Protocol):
    """A folder of frames or images."""

    @property
    def root(self) -> Path:
        """The folder beside whose parts (velodyne/, image_2/, calib/) labels may lie."""


class FrameSource(Source, Protocol):
    """Frames by name."""

    @property
    def names(self) -> Sequence[str]:
        """Names of all frames, sorted: every stem that has points or an image."""

    def load(
        self,
        name: str,
        prompts: tuple[Prompt, ...] = (),
        *,
        masks: Path | None = None,
        with_image: bool = False,
    ) -> Frame:
        """One frame. `masks` is a folder of instance masks; pixels are decoded only `with_image`.

        Raises DatasetError where a file is missing, and the InputError of whatever cannot be read.
        """


def open_source(root: Path) -> FrameSource:
    """A KITTI object root (it holds training/ or testing/) or a plain folder (velodyne/ and calib/).

    Of a root with both splits, training/ is taken; name ROOT/testing to have the other.
    Raises DatasetError where the folder is neither.
    """
    if not root.is_dir():
        raise DatasetError(str(root), "the folder does not exist.", "Check the path.")
    for split in ("training", "testing"):
        if (root / split / "velodyne").is_dir():
            return KittiObjectFolder(root / split)
    if (root / "velodyne").is_dir():
        return PlainFolder(root)
    found = sorted(path.name for path in root.iterdir())[:8]
    raise DatasetError(
        str(root),
        f"the folder is no dataset (it holds {', '.join(found) or 'nothing'}).",
        "Give a folder with velodyne/ and calib/, or one that holds training/ in KITTI object layout.",
    )


def find_labels(labels: str | Path, source: Source) -> Path:
    """The folder `labels` of KITTI text files: inside the source (`label_2`, `det_2d`), else as a path.

    Raises DatasetError where there is none.
    """
    for folder in (source.root / labels, Path(labels)):
        if folder.is_dir():
            return folder
    raise DatasetError(
        str(labels),
        f"there is no such folder, neither in {source.root} nor from here.",
        "Give label_2, det_2d or a folder of KITTI text files.",
    )


def load_objects(labels: str | Path, source: Source, name: str) -> list[KittiObject]:
    """A frame's lines from the KITTI text files of `labels` (see find_labels).

    Raises DatasetError where folder or file is missing, LabelFormatError where a line is malformed.
    """
    path = find_labels(labels, source) / f"{name}.txt"
    if not path.is_file():
        raise DatasetError(
            str(path), f"frame {name!r} has no such file.", "Add it (empty for no objects) or skip the frame."
        )
    return kitti_label.read_file(path)


def load_prompts(labels: str | Path, source: Source, name: str) -> tuple[Prompt, ...]:
    """The 2D boxes of load_objects as prompts, DontCare left out. Raises as load_objects does."""
    return kitti_label.prompts_of(load_objects(labels, source, name))
