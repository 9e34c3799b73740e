"""A label set in other formats.

What is of frames (KITTI's) is written frame by frame; all others hold sweeps in the ego frame, in which an
object that several cameras labelled is there once. Sweeps come log by log, in the order of their times.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import groupby
from typing import TYPE_CHECKING

from boxlift.datasets import FrameSource, open_source
from boxlift.errors import OptionsError
from boxlift.formats import (
    argoverse2_boxes,
    kitti_label,
    kitti_tracks,
    mcap_scene,
    nuscenes_boxes,
    openlabel,
    rerun_recording,
)
from boxlift.formats.details import kitti_object_of
from boxlift.formats.kitti_tracks import NO_TRACK, TrackedObject
from boxlift.formats.supervisely import SuperviselyProject
from boxlift.label_sets.index import LabelSetIndex, read_frames_of, sweep_of
from boxlift.storage import write_whole
from boxlift.sweep import SweepLabels, SweepSensors
from boxlift_client.sensors import sensors_of

if TYPE_CHECKING:
    from boxlift.storage import AnyPath


class Format(StrEnum):
    """What a label set can be converted to."""

    KITTI = "kitti"
    KITTI_TRACKING = "kitti-tracking"
    ARGOVERSE2 = "argoverse2"
    OPENLABEL = "openlabel"
    SUPERVISELY = "supervisely"
    NUSCENES = "nuscenes"
    MCAP = "mcap"
    RERUN = "rerun"


@dataclass
class Converted:
    """How much was written: frames or sweeps, and boxes; left_out: of classes that the format cannot hold.

    without_sensors: sweeps whose points or images could not be read from the source, which cost no label.
    """

    units: int = 0
    boxes: int = 0
    left_out: Counter[str] = field(default_factory=Counter)
    without_sensors: int = 0


# Called with the frames or sweeps done so far and all.
OnProgress = Callable[[int, int], None]


def convert(
    label_set: AnyPath,
    to: Format,
    out: AnyPath,
    *,
    min_score: float = 0.0,
    source: AnyPath | None = None,
    on_progress: OnProgress = lambda *_: None,
) -> Converted:
    """Write the labels of a label set, those with scores of `min_score` or more, to `out`.

    source: the data set, for formats that can hold points and images. Raises DatasetError where there is no
    label set, OptionsError where `out` does not suit the format, LabelFormatError, MissingExtraError and
    OSError.
    """
    _require_fitting(label_set, to, out, source)
    if to is Format.KITTI:
        return _to_kitti(label_set, out, min_score, on_progress)
    index = LabelSetIndex(label_set)
    if to is Format.KITTI_TRACKING:
        return _to_kitti_tracking(index, out, min_score, on_progress)
    opened = None if source is None else open_source(source)
    conversion = _Conversion(index, min_score, opened, on_progress)
    _WRITERS[to](conversion, out)
    return conversion.done


class _Conversion:
    """The sweeps of a label set on their way into files, counted."""

    def __init__(
        self, index: LabelSetIndex, min_score: float, source: FrameSource | None, on_progress: OnProgress
    ) -> None:
        self._index, self._min_score = index, min_score
        self._source, self._on_progress = source, on_progress
        self.done = Converted()

    def sweeps(self) -> Iterator[SweepLabels]:
        """All, log by log."""
        return (labels for labels, _ in self.with_sensors(wanted=False))

    def with_sensors(self, *, wanted: bool = True) -> Iterator[tuple[SweepLabels, SweepSensors | None]]:
        """All, log by log, with points and images where there is a source."""
        for entry in self._index.sweeps:
            labels = sweep_of(self._index.label_set, entry.frames)
            kept = tuple(each for each in labels.objects if each.score >= self._min_score)
            sensors = None
            if wanted and self._source is not None:
                sensors = sensors_of(self._source, entry.frames)
                self.done.without_sensors += sensors is None
            self.done.units += 1
            yield replace(labels, objects=kept), sensors
            self._on_progress(self.done.units, len(self._index.sweeps))


def _to_kitti(label_set: AnyPath, out: AnyPath, min_score: float, on_progress: OnProgress) -> Converted:
    """label_2 files as the training of detectors reads them: 15 columns, without scores."""
    done = Converted()
    frames = LabelSetIndex.names_in(label_set)
    for details in read_frames_of(label_set, frames):
        kept = [each.kitti for each in details.objects if each.kitti and each.score >= min_score]
        lines = [kitti_object_of(each) for each in kept]
        text = kitti_label.to_text(replace(line, score=None) for line in lines)
        write_whole(out / f"{details.frame}.txt", text.encode())
        done.units, done.boxes = done.units + 1, done.boxes + len(lines)
        on_progress(done.units, len(frames))
    return done


def _to_kitti_tracking(
    index: LabelSetIndex, out: AnyPath, min_score: float, on_progress: OnProgress
) -> Converted:
    """A file per drive and camera, with scores, as the tracking benchmark takes results.

    Frames have the numbers that their names end with where all of a drive do, else their places in it. With
    several cameras each has a folder.
    """
    done = Converted()
    for log, entries in groupby(index.sweeps, key=lambda entry: entry.log):
        of_log = list(entries)
        numbers = _frame_numbers([entry.sweep for entry in of_log])
        lines: dict[str, list[TrackedObject]] = {}
        for entry, number in zip(of_log, numbers, strict=True):
            for details in read_frames_of(index.label_set, entry.frames):
                camera = "" if details.view is None else details.view.camera
                lines.setdefault(camera, []).extend(
                    TrackedObject(
                        number, each.track.id if each.track else NO_TRACK, kitti_object_of(each.kitti)
                    )
                    for each in details.objects
                    if each.kitti is not None and each.score >= min_score
                )
            done.units += 1
            on_progress(done.units, len(index.sweeps))
        for camera, objects in lines.items():
            folder = out / camera if len(lines) > 1 else out
            write_whole(folder / f"{log or 'labels'}.txt", kitti_tracks.to_text(objects).encode())
            done.boxes += len(objects)
    return done


def _frame_numbers(sweeps: Sequence[str]) -> list[int]:
    numbers = [int(found.group()) for name in sweeps if (found := re.search(r"\d+$", name))]
    return numbers if len(set(numbers)) == len(sweeps) else list(range(len(sweeps)))


def _to_argoverse2(conversion: _Conversion, out: AnyPath) -> None:
    conversion.done.boxes = argoverse2_boxes.write_boxes(conversion.sweeps(), out)


def _to_nuscenes(conversion: _Conversion, out: AnyPath) -> None:
    results, conversion.done.left_out = nuscenes_boxes.results_of(conversion.sweeps())
    conversion.done.boxes = sum(len(boxes) for boxes in results["results"].values())
    write_whole(out, json.dumps(results).encode())


def _to_openlabel(conversion: _Conversion, out: AnyPath) -> None:
    for name, sweeps in groupby(conversion.sweeps(), key=lambda labels: labels.log or labels.sweep):
        of_log = list(sweeps)
        write_whole(out / f"{name}.json", openlabel.openlabel_json(of_log).encode())
        conversion.done.boxes += sum(len(each.objects) for each in of_log)


def _to_supervisely(conversion: _Conversion, out: AnyPath) -> None:
    project = SuperviselyProject(out)
    for labels, sensors in conversion.with_sensors():
        # Names of sweeps may be alike in two logs.
        name = labels.sweep if labels.sweep.startswith(labels.log) else f"{labels.log}_{labels.sweep}"
        project.add(name, labels, sensors)
        conversion.done.boxes += len(labels.objects)
    project.finish()


def _to_mcap(conversion: _Conversion, out: AnyPath) -> None:
    for log, sweeps in groupby(conversion.with_sensors(), key=lambda pair: pair[0].log):
        conversion.done.boxes += mcap_scene.write_scene(sweeps, out / f"{log or 'labels'}.mcap")


def _to_rerun(conversion: _Conversion, out: AnyPath) -> None:
    for log, sweeps in groupby(conversion.with_sensors(), key=lambda pair: pair[0].log):
        path = out / f"{log or 'labels'}.rrd"
        conversion.done.boxes += rerun_recording.write_recording(sweeps, path, log or "labels")


_WRITERS: dict[Format, Callable[[_Conversion, AnyPath], None]] = {
    Format.ARGOVERSE2: _to_argoverse2,
    Format.NUSCENES: _to_nuscenes,
    Format.OPENLABEL: _to_openlabel,
    Format.SUPERVISELY: _to_supervisely,
    Format.MCAP: _to_mcap,
    Format.RERUN: _to_rerun,
}
# Formats of one file, and how its name must end; all others are folders.
_SUFFIXES = {Format.ARGOVERSE2: (".parquet", ".feather"), Format.NUSCENES: (".json",)}
_HOLD_SENSORS = (Format.SUPERVISELY, Format.MCAP, Format.RERUN)


def _require_fitting(label_set: AnyPath, to: Format, out: AnyPath, source: AnyPath | None) -> None:
    suffixes = _SUFFIXES.get(to)
    if suffixes is not None and out.suffix not in suffixes:
        raise OptionsError(
            "out", f"{str(out)!r} is no name for {to}.", f"Give a file that ends in {' or '.join(suffixes)}."
        )
    if suffixes is None and out.is_file():
        raise OptionsError("out", f"{str(out)!r} is a file.", f"Give a folder: {to} is several files.")
    if source is not None and to not in _HOLD_SENSORS:
        raise OptionsError("source", f"{to} holds no points and no images.", "Leave --source out.")
    if out in (label_set, label_set / "data", label_set / "details"):
        raise OptionsError("out", f"{str(out)!r} is the label set's own.", "Give a folder beside it.")
