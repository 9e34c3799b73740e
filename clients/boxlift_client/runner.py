"""Label a dataset with an engine and count what becomes of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import perf_counter

from boxlift.datasets import find_labels, open_source
from boxlift.errors import DatasetError, OptionsError
from boxlift_client.engines import Engine
from boxlift_client.job import LabelJob
from boxlift_client.summary import RunSummary


def label_dataset(
    job: LabelJob,
    engine: Engine,
    names: Sequence[str] | None = None,
    on_progress: Callable[[int, int], None] = lambda *_: None,
) -> RunSummary:
    """Label the frames `names` (all where None) of a job's source.

    `on_progress` hears of the frames done and of all. A frame that cannot be labelled is listed in the
    summary and costs no other. Raises BoxliftError where nothing can be labelled: no dataset, no
    prompts, no service.
    """
    start = perf_counter()
    source = open_source(job.source)
    if not job.detects:
        find_labels(job.prompts, source)
    try:
        for folder in (job.out / "data", job.out / "details"):
            folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OptionsError(
            "out", f"{str(job.out)!r} cannot be made ({error.strerror}).", "Give a folder to write to."
        ) from None
    chosen = source.names if names is None else list(dict.fromkeys(names))
    if not chosen:
        raise DatasetError(str(job.source), "there is no frame to label.", "Put point clouds into velodyne/.")
    summary = RunSummary()
    on_progress(0, len(chosen))
    for done, report in enumerate(engine.run(job, chosen), start=1):
        summary.add(report)
        on_progress(done, len(chosen))
    summary.seconds = perf_counter() - start
    return summary
