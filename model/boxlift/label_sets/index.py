"""What is in a label set, frame by frame or sweep by sweep, without holding all of it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pydantic import ValidationError

from boxlift.errors import DatasetError, LabelFormatError
from boxlift.formats import details
from boxlift.formats.details import FrameDetails
from boxlift.formats.ego_boxes import sweep_labels_of_details
from boxlift.merging import merge_views
from boxlift.storage import is_folder, names_in, read_whole
from boxlift.sweep import SweepLabels

if TYPE_CHECKING:
    from boxlift.storage import AnyPath


def read_frames_of(label_set: AnyPath, names: Iterable[str] | None = None) -> Iterator[FrameDetails]:
    """The details of every frame (or of `names`), by name.

    Raises DatasetError where there is no label set, LabelFormatError, OSError.
    """
    for name in LabelSetIndex.names_in(label_set) if names is None else names:
        yield read_details(label_set / "details" / f"{name}.json")


def read_sweeps_of(label_set: AnyPath) -> Iterator[SweepLabels]:
    """The labels of every sweep in its ego frame, what several cameras saw once; log by log.

    Raises as read_frames_of.
    """
    for entry in LabelSetIndex(label_set).sweeps:
        yield sweep_of(label_set, entry.frames)


def sweep_of(label_set: AnyPath, frames: Sequence[str]) -> SweepLabels:
    """The labels of one sweep from those of its frames, merged. Raises LabelFormatError, OSError."""
    paths = (label_set / "details" / f"{name}.json" for name in frames)
    return merge_views([sweep_labels_of_details(read_details(path)) for path in paths])


@dataclass(frozen=True)
class SweepEntry:
    """One sweep and its frames, by name."""

    log: str
    sweep: str
    timestamp_ns: int | None
    frames: tuple[str, ...]


class LabelSetIndex:
    """Which frames are of which sweep. Raises as read_frames_of.

    sweeps: log by log, in the order of their times, else of their names.
    """

    def __init__(self, label_set: AnyPath) -> None:
        self.label_set = label_set
        frames_of: dict[tuple[str, str], list[str]] = {}
        times: dict[tuple[str, str], int | None] = {}
        for frame in read_frames_of(label_set):
            view = frame.view
            key = ("", frame.frame) if view is None else (view.log, view.sweep)
            frames_of.setdefault(key, []).append(frame.frame)
            times.setdefault(key, None if view is None else view.timestamp_ns)
        entries = [SweepEntry(*key, times[key], tuple(frames)) for key, frames in frames_of.items()]
        self.sweeps = sorted(entries, key=lambda each: (each.log, each.timestamp_ns or 0, each.sweep))

    @staticmethod
    def names_in(label_set: AnyPath) -> list[str]:
        """Names of all frames that have labels. Raises DatasetError where there is no label set."""
        folder = label_set / "details"
        if not is_folder(folder):
            raise DatasetError(
                str(label_set), "the folder is no label set.", "Give one that boxlift label or detect wrote."
            )
        names = (name for name in names_in(folder) if name.endswith(".json") and name[0] != ".")
        return sorted(name.removesuffix(".json") for name in names)


def read_details(path: AnyPath) -> FrameDetails:
    """A details file. Raises LabelFormatError, OSError."""
    try:
        return details.parse_text(read_whole(path))
    except ValidationError as error:
        raise LabelFormatError(
            str(path),
            f"the file holds no details of boxlift ({error.errors()[0]['msg']}).",
            "Label the frame again.",
        ) from None
