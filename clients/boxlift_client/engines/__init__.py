"""What maps the frames of a job to workers: one file per engine, all behind Engine or DetectEngine."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import boxlift
from boxlift.errors import ModelFileError
from boxlift_client.detect_job import DetectJob
from boxlift_client.job import FrameReport, LabelJob


@dataclass(frozen=True)
class LabellerIdentity:
    """Who labels: the version of boxlift, and the SHA-256 of the detector's file where it finds prompts."""

    version: str
    detector_digest: str | None


class Engine(Protocol):
    """Labels the frames of a job, in any order, each once."""

    def identity(self, job: LabelJob) -> LabellerIdentity:
        """Who would label the frames of a job. Raises BoxliftError where nobody would."""

    def run(self, job: LabelJob, names: Sequence[str]) -> Iterator[FrameReport]:
        """One report per frame, as they finish. Raises BoxliftError where no frame could be labelled."""


class DetectEngine(Protocol):
    """Detects in the images of a job, in any order, each once."""

    def run(self, job: DetectJob, names: Sequence[str]) -> Iterator[FrameReport]:
        """One report per image, as they finish. Raises BoxliftError where no image could be looked at."""


def own_identity(job: LabelJob) -> LabellerIdentity:
    """Who labels where the boxlift that is installed here does. Raises ModelFileError."""
    if not job.detects:
        return LabellerIdentity(boxlift.__version__, None)
    from boxlift.detector.detector import DEFAULT_FILE

    path = job.detector or DEFAULT_FILE
    try:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        what = "does not exist" if isinstance(error, FileNotFoundError) else "cannot be read"
        raise ModelFileError(str(path), f"the path {what}.", "Give the path of an ONNX model.") from None
    return LabellerIdentity(boxlift.__version__, digest)
