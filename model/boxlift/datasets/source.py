"""What every dataset layout offers, and how a folder's layout is told."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Protocol, cast

from boxlift.errors import DatasetError
from boxlift.formats import kitti_label
from boxlift.formats.kitti_label import KittiObject
from boxlift.frame import Frame, Prompt
from boxlift.storage import is_folder, open_path

if TYPE_CHECKING:
    from boxlift.storage import AnyPath

# Modules of this package, each with `recognise(root) -> FrameSource | None`, in the order in which they are
# asked. They are imported when a source is opened: some need libraries that others do not.
_LAYOUTS = (
    "kitti_tracking",
    "kitti_object",
    "plain_folder",
    "kitti_raw",
    "nuscenes",
    "argoverse2",
    "waymo",
    "mcap_recordings",
)


class Source(Protocol):
    """A folder of frames or images."""

    @property
    def root(self) -> AnyPath:
        """The folder beside whose parts (velodyne/, image_2/, calib/) labels may lie."""

    @property
    def label_names(self) -> Sequence[str]:
        """What `objects` knows: the data set's own annotations, beyond folders of KITTI text files."""

    def objects(self, labels: str, name: str) -> list[KittiObject]:
        """The annotations `labels` (of label_names) of a frame, in its rectified camera.

        2D boxes are the data set's own, else the outlines of its 3D boxes in the image. Raises DatasetError.
        """


class FrameSource(Source, Protocol):
    """Frames by name. A frame is one camera's view of one LiDAR sweep."""

    @property
    def layout(self) -> str:
        """The layout's name as its users know it, e.g. "KITTI raw"."""

    @property
    def names(self) -> Sequence[str]:
        """Names of all frames, sorted; each is the stem of a file name."""

    def load(
        self,
        name: str,
        prompts: tuple[Prompt, ...] = (),
        *,
        masks: AnyPath | None = None,
        with_image: bool = False,
    ) -> Frame:
        """One frame. `masks` is a folder of instance masks; pixels are decoded only `with_image`.

        Raises DatasetError where a file is missing, and the InputError of whatever cannot be read.
        """


def open_source(root: AnyPath) -> FrameSource:
    """The data set in a folder (or file), in the first layout of _LAYOUTS that recognises it.

    Raises DatasetError where none does.
    """
    if not root.exists():
        raise DatasetError(str(root), "the folder does not exist.", "Check the path.")
    for layout in _LAYOUTS:
        if (source := import_module(f"boxlift.datasets.{layout}").recognise(root)) is not None:
            return cast(FrameSource, source)
    found = sorted(path.name for path in root.iterdir())[:8] if is_folder(root) else ["a file"]
    raise DatasetError(
        str(root),
        f"the folder is no dataset (it holds {', '.join(found) or 'nothing'}).",
        "Give a folder with velodyne/ and calib/, or one that holds training/ in KITTI object layout.",
    )


def find_labels(labels: str | AnyPath, source: Source) -> AnyPath:
    """The folder `labels` of KITTI text files: inside the source (`label_2`, `det_2d`), else as a path.

    Raises DatasetError where there is none.
    """
    if not isinstance(labels, str):
        return labels
    for folder in (source.root / labels, open_path(labels)):
        if is_folder(folder):
            return folder
    raise DatasetError(
        str(labels),
        f"there is no such folder, neither in {source.root} nor from here.",
        "Give label_2, det_2d or a folder of KITTI text files.",
    )


def load_objects(labels: str | AnyPath, source: Source, name: str) -> list[KittiObject]:
    """A frame's annotations that its data set has under the name `labels`, else its lines in the KITTI text
    files of that folder (a path: see find_labels).

    Raises DatasetError where folder or file is missing, LabelFormatError where a line is malformed.
    """
    if isinstance(labels, str) and labels in source.label_names:
        return source.objects(labels, name)
    path = find_labels(labels, source) / f"{name}.txt"
    try:
        return kitti_label.read_file(path)
    except FileNotFoundError:
        raise DatasetError(
            str(path), f"frame {name!r} has no such file.", "Add it (empty for no objects) or skip the frame."
        ) from None


def load_prompts(labels: str | AnyPath, source: Source, name: str) -> tuple[Prompt, ...]:
    """The 2D boxes of load_objects as prompts, DontCare left out. Raises as load_objects does."""
    return kitti_label.prompts_of(load_objects(labels, source, name))
