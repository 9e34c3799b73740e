"""One run of the monocular model over images, and one image of it: read, detect, write, report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from boxlift.datasets import ImageFolder, load_prompts, open_images
from boxlift.formats.details import FrameDetails
from boxlift.frame import Prompt
from boxlift_client.job import FrameReport, Outcome, report
from boxlift_client.label_files import write_label_files


@dataclass(frozen=True)
class DetectJob:
    """Which images, by which cameras, with which 2D boxes, and where the labels go.

    images and calib: see open_images. out: the labels' folder. prompts: a folder of KITTI text files beside
    the images (`label_2`) or anywhere; None: the model finds the objects. min_score: least score of what it
    finds.
    """

    images: Path
    out: Path
    calib: Path | None = None
    prompts: str | None = None
    min_score: float = 0.0


# A folder, the name of an image in it and its prompts -> what was found.
Detect = Callable[[ImageFolder, str, tuple[Prompt, ...] | None], FrameDetails]


class ImageWorker:
    """Detects in the images of a job one by one; `detect` is a model here or a service elsewhere."""

    def __init__(self, job: DetectJob, detect: Detect) -> None:
        self._job = job
        self._detect = detect
        self._folder = open_images(job.images, job.calib)

    def detect_one(self, name: str) -> FrameReport:
        """Read, detect and write one image. Whatever is wrong with it is told in the report.

        Raises MissingExtraError, which no other image would fare better with.
        """
        return report(name, lambda: self._detect_and_write(name))

    def _detect_and_write(self, name: str) -> tuple[Outcome, str, FrameDetails]:
        prompts = None if self._job.prompts is None else load_prompts(self._job.prompts, self._folder, name)
        details = self._detect(self._folder, name, prompts)
        write_label_files(self._job.out, name, details)
        return Outcome.LABELLED, "", details
