"""One run over a dataset, and one frame of it: load, label, write, report."""

from __future__ import annotations

import errno
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from boxlift.datasets import FrameSource, find_labels, load_prompts, open_source
from boxlift.errors import BoxliftError, DatasetError, MissingExtraError, NoLidarError
from boxlift.formats.details import FrameDetails, details_of, view_details_of
from boxlift.frame import Frame, FrameLabels, Prompt, Result
from boxlift.label_sets.files import write_label_files
from boxlift.poses import inverse
from boxlift.settings import ACCURATE, LabellerSettings
from boxlift.sweep import SweepView

if TYPE_CHECKING:
    from boxlift.storage import AnyPath

# As `prompts` of a job: what a detector finds in each image.
DETECTOR = "detector"
# What the one camera of a data set without names for cameras is called.
ONLY_CAMERA = "image_2"


@dataclass(frozen=True)
class LabelJob:
    """Where frames and prompts come from, how they are labelled, and where the labels go.

    source: a dataset root or folder. out: the label set's folder. prompts: a folder of KITTI text files,
    inside the source (`label_2`, `det_2d`) or anywhere; annotations that the data set has by that name; or
    DETECTOR. masks: a folder of instance masks. detector: the file of a detector, for workers on this
    machine; the one in boxlift where None. frame_timeout_s: a frame that takes longer has failed; None: the
    engine tells from the others. A job is plain data, so that processes and machines can be handed it.
    """

    source: AnyPath
    out: AnyPath
    prompts: str = DETECTOR
    masks: AnyPath | None = None
    settings: LabellerSettings = ACCURATE
    detector: Path | None = None
    frame_timeout_s: float | None = None

    @property
    def detects(self) -> bool:
        """Whether the prompts are to be found in the images."""
        return self.prompts == DETECTOR


class Outcome(StrEnum):
    """What became of a frame."""

    LABELLED = "labelled"
    SKIPPED = "skipped"  # no LiDAR: the files are there, and say of every prompt that it has no box
    FAILED = "failed"


@dataclass(frozen=True)
class FrameReport:
    """What became of a frame: (result, sentence) per prompt, or the sentence why it has no labels.

    warnings: (name, sentence) of every doubt about its calibration. boxes: prompts that have a box. digest:
    SHA-256 over the bytes of its two files, where they were written. fatal: it failed for a reason that no
    other frame would fare better with (a disk that is full, a library that is missing).
    """

    frame: str
    outcome: Outcome
    sentence: str = ""
    results: tuple[tuple[str, str], ...] = ()
    warnings: tuple[tuple[str, str], ...] = ()
    seconds: float = 0.0
    boxes: int = 0
    digest: str | None = None
    fatal: bool = False


def report_of(
    name: str, outcome: Outcome, sentence: str, details: FrameDetails, digest: str, seconds: float
) -> FrameReport:
    """The report of a frame whose files were written."""
    return FrameReport(
        name,
        outcome,
        sentence,
        results=tuple((item.result, item.sentence) for item in details.objects),
        warnings=tuple((item.name, item.sentence) for item in details.warnings),
        seconds=seconds,
        boxes=sum(item.kitti is not None for item in details.objects),
        digest=digest,
    )


def report_of_failure(name: str, error: Exception, seconds: float) -> FrameReport:
    """The report of a frame that raised `error`; one frame's surprise must not cost the others."""
    sentence = str(error) if isinstance(error, BoxliftError) else f"{type(error).__name__}: {error}"
    full = isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT)
    fatal = full or isinstance(error, MissingExtraError)
    return FrameReport(name, Outcome.FAILED, sentence, seconds=seconds, fatal=fatal)


@dataclass(frozen=True)
class LoadedFrame:
    """A frame that waits to be labelled; `details` are there at once where it has no LiDAR to label from."""

    name: str
    frame: Frame | None
    details: FrameDetails | None = None
    sentence: str = ""

    @property
    def given_frame(self) -> Frame:
        """The frame, where there are no details yet."""
        assert self.frame is not None
        return self.frame


def labels_of(job: LabelJob, source: FrameSource) -> str | AnyPath | None:
    """Where the prompts of a job are, for load_prompts; None where they are to be found in the images.

    Raises DatasetError where there is no such folder.
    """
    if job.detects or job.prompts in source.label_names:
        return None if job.detects else job.prompts
    return find_labels(job.prompts, source)


class FrameStore:
    """Loads the frames of a job, and writes their labels."""

    def __init__(self, job: LabelJob) -> None:
        self._job = job
        self._source: FrameSource = open_source(job.source)
        self._labels = labels_of(job, self._source)

    def load(self, name: str) -> LoadedFrame:
        """The frame with its prompts. Raises BoxliftError."""
        frame, sentence = None, ""
        try:
            frame = self._source.load(name, masks=self._job.masks, with_image=self._job.detects)
        except NoLidarError as error:
            sentence = str(error)
        prompts = self._prompts(name, frame)
        if frame is None:
            nothing = details_of(FrameLabels.without_boxes(name, prompts, Result.NO_LIDAR))
            return LoadedFrame(name, None, nothing, sentence)
        return LoadedFrame(name, replace(frame, prompts=prompts))

    def finish(self, loaded: LoadedFrame, details: FrameDetails, seconds: float) -> FrameReport:
        """Write the files of a frame. Raises OSError where they cannot be written."""
        if loaded.frame is not None:
            details = details.model_copy(update={"view": view_details_of(view_of(loaded.frame))})
        digest = write_label_files(self._job.out, loaded.name, details)
        outcome = Outcome.LABELLED if loaded.frame else Outcome.SKIPPED
        return report_of(loaded.name, outcome, loaded.sentence, details, digest, seconds)

    def _prompts(self, name: str, frame: Frame | None) -> tuple[Prompt, ...]:
        """Those on disk; none yet where they are to be found in the image. Raises InputError."""
        if self._labels is not None:
            prompts = load_prompts(self._labels, self._source, name)
            if frame is None or frame.lens is None or self._labels in self._source.label_names:
                return prompts
            lens, size_px = frame.lens, frame.image_size_px
            return tuple(replace(each, box_px=lens.rectified_box(each.box_px, size_px)) for each in prompts)
        if frame is not None and frame.image is None:
            raise DatasetError(
                str(self._source.root / "image_2"),
                f"frame {name!r} has no image to find objects in.",
                "Add its image, or give 2D boxes with --prompts.",
            )
        return ()


class FrameWorker:
    """Labels the frames of a job one by one; `label` is a labeller.

    In a job that detects, it finds the prompts too, in the image of the frame that it is given.
    """

    def __init__(self, job: LabelJob, label: Callable[[Frame], FrameDetails]) -> None:
        self._store = FrameStore(job)
        self._label = label

    def label_one(self, name: str) -> FrameReport:
        """Load, label and write one frame. Never raises: whatever is wrong is told in the report."""
        start = perf_counter()
        try:
            loaded = self._store.load(name)
            details = loaded.details or self._label(loaded.given_frame)
            return self._store.finish(loaded, details, perf_counter() - start)
        except Exception as error:
            return report_of_failure(name, error, perf_counter() - start)


def view_of(frame: Frame) -> SweepView:
    """The frame's own; where it has none, its LiDAR frame is the ego frame and its camera the only one."""
    return frame.view or SweepView(frame.name, ONLY_CAMERA, inverse(frame.calibration.cam_SE3_velo))
