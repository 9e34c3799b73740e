"""One run of the monocular model over images, and one image of it: read, detect, write, report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

from boxlift.datasets import ImageFolder, load_prompts, open_images
from boxlift.formats.details import FrameDetails
from boxlift.frame import Prompt
from boxlift.label_sets.files import write_label_files
from boxlift_client.job import FrameReport, Outcome, report_of, report_of_failure


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
        """Read, detect and write one image. Never raises: whatever is wrong is told in the report."""
        start = perf_counter()
        try:
            labels = self._job.prompts
            prompts = None if labels is None else load_prompts(labels, self._folder, name)
            details = self._detect(self._folder, name, prompts)
            digest = write_label_files(self._job.out, name, details)
            return report_of(name, Outcome.LABELLED, "", details, digest, perf_counter() - start)
        except Exception as error:
            return report_of_failure(name, error, perf_counter() - start)
