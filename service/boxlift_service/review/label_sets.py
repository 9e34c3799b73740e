"""Which label sets people may open, and one of them as it is open."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path, PurePath
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from boxlift.corrections.store import CorrectionStore, default_url
from boxlift.errors import DatasetError
from boxlift.formats.details import FrameDetails
from boxlift.frame import Frame
from boxlift.label_sets.files import details_path
from boxlift.label_sets.manifest import MANIFEST, read_manifest
from boxlift.label_sets.reader import LabelSetReader
from boxlift_service.problems import Kind, ProblemError
from boxlift_service.review.queue import ReviewQueue

# A label set, and those in it: LABELS, LABELS/tracked.
_DEEPEST = 3
_FRAMES_KEPT = 4


class OpenLabelSet:
    """A label set that people look at. Methods block; call them in a thread.

    Raises DatasetError where it has no manifest, LabelFormatError, OptionsError for its corrections.
    """

    def __init__(self, name: str, folder: Path, corrections_url: str | None) -> None:
        self.name = name
        self.folder = folder
        manifest = read_manifest(folder)
        if manifest is None:
            raise DatasetError(str(folder), f"it has no {MANIFEST}.", "Label its frames again.")
        self._reader = LabelSetReader(folder, manifest)
        self.store = CorrectionStore(corrections_url or default_url(folder), name)
        self.queue = ReviewQueue(folder)
        self._lock = Lock()
        self._frames: dict[str, Frame] = {}

    def details(self, frame: str) -> FrameDetails:
        """A frame's labels. Raises ProblemError where there is no such frame, LabelFormatError."""
        self._require(frame)
        return self._reader.details(frame)

    def load(self, frame: str) -> Frame:
        """A frame of the data set, with its image where it has one. Raises as details, and InputError."""
        self._require(frame)
        with self._lock:
            if frame not in self._frames:
                while len(self._frames) >= _FRAMES_KEPT:
                    del self._frames[next(iter(self._frames))]
                self._frames[frame] = self._reader.load(frame, (), with_image=True)
            return self._frames[frame]

    def _require(self, frame: str) -> None:
        # A name with a separator could lead out of the label set.
        if PurePath(frame).name != frame or not details_path(self.folder, frame).is_file():
            raise ProblemError(
                Kind.NOT_FOUND,
                f"The label set {self.name!r} has no frame {frame!r:.200}.",
                "GET /review/queue lists them.",
                field="frame",
            )

    def close(self) -> None:
        """Let go of the corrections, and stop to read."""
        self.queue.stop()
        self.store.close()


def points_cam(frame: Frame) -> NDArray[np.float32]:
    """(N, 3) points in the rectified camera frame, metres, as a page draws them."""
    return frame.calibration.velo_to_cam(frame.points_velo[:, :3]).astype("<f4")


class LabelSets:
    """The label sets in `root`: itself, where it is one, and its folders that are.

    A name is the path from the folder that holds `root`, e.g. LABELS or LABELS/tracked. corrections_url: the
    database that keeps all corrections; None: one beside the labels of each.
    """

    def __init__(self, root: Path, corrections_url: str | None) -> None:
        self.root = root.absolute()
        self._corrections_url = corrections_url
        self._open: dict[str, OpenLabelSet] = {}
        self._lock = Lock()

    def names(self) -> list[str]:
        """Names of the label sets that are there now."""
        folders = _label_sets_in(self.root, _DEEPEST)
        return sorted(self.name_of(folder) for folder in folders)

    def name_of(self, folder: Path) -> str:
        """The name of the label set in `folder`."""
        return folder.relative_to(self.root.parent).as_posix()

    def open(self, name: str) -> OpenLabelSet:
        """The label set of that name, opened once. Raises ProblemError where there is none."""
        with self._lock:
            if name not in self._open:
                if name not in self.names():
                    raise ProblemError(
                        Kind.NOT_FOUND,
                        f"There is no label set {name!r:.200}.",
                        "GET /review/label-sets lists them.",
                        field="set",
                    )
                self._open[name] = OpenLabelSet(name, self.root.parent / name, self._corrections_url)
            return self._open[name]

    def changed(self, name: str, change: Callable[[], None]) -> None:
        """Make a change to the files of a label set; what was known of it is forgotten."""
        with self._lock:
            change()
            if (opened := self._open.pop(name, None)) is not None:
                opened.close()

    def close(self) -> None:
        """Close all of them."""
        with self._lock:
            for each in self._open.values():
                each.close()
            self._open.clear()


def _label_sets_in(folder: Path, depth: int) -> list[Path]:
    """Folders with details/ and a manifest; data sets, which may be large, are not walked through."""
    if depth == 0 or not folder.is_dir():
        return []
    found = [folder] if (folder / MANIFEST).is_file() and (folder / "details").is_dir() else []
    skipped = {"data", "details", "ledger", "tracks", "frames"}
    for child in folder.iterdir():
        if child.name not in skipped and not child.name.startswith(".") and child.is_dir():
            found += _label_sets_in(child, depth - 1)
    return found
