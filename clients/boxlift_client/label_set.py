"""What is in a label set, frame by frame or sweep by sweep, without holding all of it."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from itertools import groupby
from typing import TYPE_CHECKING

from pydantic import ValidationError

from boxlift.errors import DatasetError, LabelFormatError
from boxlift.formats import details
from boxlift.formats.details import FrameDetails
from boxlift.formats.ego_boxes import sweep_labels_of_details
from boxlift.merging import merge_views
from boxlift.storage import read_whole
from boxlift.sweep import SweepLabels

if TYPE_CHECKING:
    from boxlift.storage import AnyPath


def read_frames_of(label_set: AnyPath, names: Collection[str] | None = None) -> Iterator[FrameDetails]:
    """The details of every frame (or of `names`), by name.

    Raises DatasetError where there is no label set or frame, LabelFormatError.
    """
    folder = label_set / "details"
    if not folder.is_dir():
        raise DatasetError(
            str(label_set), "the folder is no label set.", "Give one that boxlift label or detect wrote."
        )
    there = sorted(path.stem for path in folder.glob("*.json"))
    if names is not None:
        if missing := sorted(set(names) - set(there)):
            raise DatasetError(
                str(folder), f"frame {missing[0]!r} has no labels ({len(missing)} are missing).", "Label it."
            )
        there = sorted(names)
    for name in there:
        yield read_details(folder / f"{name}.json")


def read_sweeps_of(label_set: AnyPath, names: Collection[str] | None = None) -> Iterator[SweepLabels]:
    """The labels of every sweep in its ego frame, what several cameras saw once. Raises as read_frames_of.

    Names of the views of a sweep begin alike in every layout that has several, so that they come together.
    """
    views = map(sweep_labels_of_details, read_frames_of(label_set, names))
    for _, of_sweep in groupby(views, key=lambda each: (each.log, each.sweep)):
        yield merge_views(list(of_sweep))


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
