"""One run over a dataset, and one frame of it: load, label, write, report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from time import perf_counter

from boxlift.datasets import FrameSource, load_prompts, open_source
from boxlift.errors import BoxliftError, DatasetError, MissingExtraError, NoLidarError
from boxlift.formats.details import FrameDetails, details_of
from boxlift.frame import Frame, FrameLabels, Prompt, Result
from boxlift.settings import ACCURATE, LabellerSettings
from boxlift_client.label_files import write_label_files

# As `prompts` of a job: what a detector finds in each image.
DETECTOR = "detector"


@dataclass(frozen=True)
class LabelJob:
    """Where frames and prompts come from, how they are labelled, and where the labels go.

    source: a dataset root or folder. out: the labels' folder. prompts: a folder of KITTI text files,
    inside the source (`label_2`, `det_2d`) or anywhere; or DETECTOR. masks: a folder of instance masks.
    detector: the file of a detector, for workers on this machine; the one in boxlift where None. A job is
    plain data, so that processes and machines can be handed it.
    """

    source: Path
    out: Path
    prompts: str = DETECTOR
    masks: Path | None = None
    settings: LabellerSettings = ACCURATE
    detector: Path | None = None

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

    warnings: (name, sentence) of every doubt about its calibration.
    """

    frame: str
    outcome: Outcome
    sentence: str = ""
    results: tuple[tuple[str, str], ...] = ()
    warnings: tuple[tuple[str, str], ...] = ()
    seconds: float = 0.0


def report(name: str, work: Callable[[], tuple[Outcome, str, FrameDetails]]) -> FrameReport:
    """What became of the frame `name` by `work`: outcome, sentence and details, or whatever it raised.

    Raises MissingExtraError, which no other frame would fare better with.
    """
    start = perf_counter()
    try:
        outcome, sentence, details = work()
    except MissingExtraError:
        raise
    except BoxliftError as error:
        return FrameReport(name, Outcome.FAILED, str(error), seconds=perf_counter() - start)
    # One frame's surprise (a full disk, a fault of ours) must not cost the others.
    except Exception as error:
        sentence = f"{type(error).__name__}: {error}"
        return FrameReport(name, Outcome.FAILED, sentence, seconds=perf_counter() - start)
    results = tuple((item.result, item.sentence) for item in details.objects)
    warnings = tuple((item.name, item.sentence) for item in details.warnings)
    return FrameReport(name, outcome, sentence, results, warnings, seconds=perf_counter() - start)


class FrameWorker:
    """Labels the frames of a job one by one; `label` is a labeller here or a service elsewhere.

    In a job that detects, it finds the prompts too, in the image of the frame that it is given.
    """

    def __init__(self, job: LabelJob, label: Callable[[Frame], FrameDetails]) -> None:
        self._job = job
        self._label = label
        self._source: FrameSource = open_source(job.source)

    def label_one(self, name: str) -> FrameReport:
        """Load, label and write one frame. Whatever is wrong with the frame is told in the report.

        Raises MissingExtraError, which no other frame would fare better with.
        """
        return report(name, lambda: self._label_and_write(name))

    def _label_and_write(self, name: str) -> tuple[Outcome, str, FrameDetails]:
        frame, outcome, sentence = None, Outcome.LABELLED, ""
        try:
            frame = self._source.load(name, masks=self._job.masks, with_image=self._job.detects)
        except NoLidarError as error:
            outcome, sentence = Outcome.SKIPPED, str(error)
        prompts = self._prompts(name, frame)
        if frame is None:
            details = details_of(FrameLabels.without_boxes(name, prompts, Result.NO_LIDAR))
        else:
            details = self._label(replace(frame, prompts=prompts))
        write_label_files(self._job.out, name, details)
        return outcome, sentence, details

    def _prompts(self, name: str, frame: Frame | None) -> tuple[Prompt, ...]:
        """Those on disk; none yet where they are to be found in the image. Raises InputError."""
        if not self._job.detects:
            return load_prompts(self._job.prompts, self._source, name)
        if frame is not None and frame.image is None:
            raise DatasetError(
                str(self._source.root / "image_2"),
                f"frame {name!r} has no image to find objects in.",
                "Add its image, or give 2D boxes with --prompts.",
            )
        return ()
