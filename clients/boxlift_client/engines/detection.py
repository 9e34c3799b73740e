"""What maps the images of a job to a model: here, or in a service elsewhere."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from boxlift.datasets import ImageFolder
from boxlift.errors import CalibrationError
from boxlift.formats.details import FrameDetails, details_of
from boxlift.formats.image import decode_image
from boxlift.frame import Prompt
from boxlift_client.client import Client
from boxlift_client.detect_job import DetectJob, ImageWorker
from boxlift_client.engines.http import PATIENCE_S, REQUESTS_IN_FLIGHT
from boxlift_client.in_threads import in_threads
from boxlift_client.job import FrameReport

# More threads than this wait for each other: the layers of the model are small.
_MOST_THREADS_UNASKED = 4


class LocalDetectEngine:
    """The model of a file (the one that ships where None) in this process, one image after the other."""

    def __init__(self, model: Path | None = None, threads: int | None = None) -> None:
        self._model = model
        self._threads = threads or min(os.cpu_count() or 1, _MOST_THREADS_UNASKED)

    def run(self, job: DetectJob, names: Sequence[str]) -> Iterator[FrameReport]:
        """See DetectEngine.run. Raises ModelFileError, MissingExtraError."""
        from boxlift.monocular import Monocular

        model = Monocular.open(self._model, self._threads)

        def detect(folder: ImageFolder, name: str, prompts: tuple[Prompt, ...] | None) -> FrameDetails:
            path, parsed = folder.image_path(name), folder.camera(name)
            image = decode_image(path, str(path))
            size_px = image.shape[1], image.shape[0]
            calib = str(folder.calibration_path(name))
            if parsed.image_size_px not in (None, size_px):
                problem = f"it is {parsed.image_size_px}, the image {path} has {size_px}."
                raise CalibrationError(f"{calib}.image_size", problem, "Give the calibration of this image.")
            try:
                labels = model.detect(name, image, parsed.calibration, prompts, min_score=job.min_score)
            except CalibrationError as error:
                raise CalibrationError(f"{calib}.P2", error.problem, error.remedy) from None
            return details_of(labels, model.digest)

        worker = ImageWorker(job, detect)
        return map(worker.detect_one, names)


class HttpDetectEngine:
    """Requests to the service at `url`, some of them in flight."""

    def __init__(self, url: str, workers: int | None = None) -> None:
        self._url = url
        self._workers = workers or REQUESTS_IN_FLIGHT

    def run(self, job: DetectJob, names: Sequence[str]) -> Iterator[FrameReport]:
        """See DetectEngine.run. Raises ServiceError where the service is not there or not ready."""
        with Client(self._url, patience_s=PATIENCE_S) as client:
            client.wait_until_ready()

            def detect(folder: ImageFolder, name: str, prompts: tuple[Prompt, ...] | None) -> FrameDetails:
                answer = client.detect_files(
                    [folder.image_path(name)],
                    [folder.calibration_path(name)],
                    None if prompts is None else [prompts],
                    min_score=job.min_score,
                )
                return answer.details(0, name)

            yield from in_threads(ImageWorker(job, detect).detect_one, names, self._workers)
