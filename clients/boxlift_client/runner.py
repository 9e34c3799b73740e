"""Label a dataset, or find objects in images, with an engine and count what becomes of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from time import perf_counter

from boxlift.datasets import find_labels, open_images, open_source
from boxlift.errors import DatasetError, OptionsError
from boxlift_client.detect_job import DetectJob
from boxlift_client.engines import DetectEngine, Engine
from boxlift_client.job import FrameReport, LabelJob
from boxlift_client.summary import RunSummary

# Called with the frames done so far and all frames.
OnProgress = Callable[[int, int], None]


def label_dataset(
    job: LabelJob,
    engine: Engine,
    names: Sequence[str] | None = None,
    on_progress: OnProgress = lambda *_: None,
) -> RunSummary:
    """Label the frames `names` (all where None) of a job's source.

    `on_progress` hears of the frames done and of all. A frame that cannot be labelled is listed in the
    summary and costs no other. Raises BoxliftError where nothing can be labelled: no dataset, no
    prompts, no service.
    """
    source = open_source(job.source)
    if not job.detects:
        find_labels(job.prompts, source)
    chosen = source.names if names is None else list(dict.fromkeys(names))
    if not chosen:
        raise DatasetError(str(job.source), "there is no frame to label.", "Put point clouds into velodyne/.")
    return _run(job.out, chosen, lambda: engine.run(job, chosen), RunSummary(), on_progress)


def detect_images(
    job: DetectJob,
    engine: DetectEngine,
    names: Sequence[str] | None = None,
    on_progress: OnProgress = lambda *_: None,
) -> RunSummary:
    """Find the objects of the images `names` (all where None) of a job, or lift its 2D boxes.

    As label_dataset. Raises BoxliftError where nothing can be done: no images, no model, no service.
    """
    folder = open_images(job.images, job.calib)
    if job.prompts is not None:
        find_labels(job.prompts, folder)
    chosen = folder.names if names is None else list(dict.fromkeys(names))
    return _run(job.out, chosen, lambda: engine.run(job, chosen), RunSummary(noun="object"), on_progress)


def _run(
    out: Path,
    names: Sequence[str],
    start_reports: Callable[[], Iterator[FrameReport]],
    summary: RunSummary,
    on_progress: OnProgress,
) -> RunSummary:
    """Make the folders, then count the reports."""
    start = perf_counter()
    try:
        for folder in (out / "data", out / "details"):
            folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OptionsError(
            "out", f"{str(out)!r} cannot be made ({error.strerror}).", "Give a folder to write to."
        ) from None
    on_progress(0, len(names))
    for done, report in enumerate(start_reports(), start=1):
        summary.add(report)
        on_progress(done, len(names))
    summary.seconds = perf_counter() - start
    return summary
