"""Label a dataset, or find objects in images, with an engine and count what becomes of it."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from boxlift.datasets import find_labels, open_images, open_source
from boxlift.errors import DatasetError, OptionsError
from boxlift.label_sets.ledger_parts import LEDGER
from boxlift.label_sets.manifest import Manifest
from boxlift_client.detect_job import DetectJob
from boxlift_client.engines import DetectEngine, Engine
from boxlift_client.errors import RunStoppedError
from boxlift_client.job import FrameReport, LabelJob, Outcome, labels_of
from boxlift_client.joining import join_label_set
from boxlift_client.ledger import LedgerRow, LedgerState, LedgerWriter, read_ledger
from boxlift_client.leftovers import remove_leftovers, write_failed
from boxlift_client.shard import Shard
from boxlift_client.summary import RunSummary

if TYPE_CHECKING:
    from boxlift.storage import AnyPath

# Called with the frames done so far and all frames.
OnProgress = Callable[[int, int], None]


def label_dataset(
    job: LabelJob,
    engine: Engine,
    names: Sequence[str] | None = None,
    on_progress: OnProgress = lambda *_: None,
    *,
    shard: Shard | None = None,
    retry_failed: bool = False,
) -> RunSummary:
    """Label the frames `names` (all where None) of a job's source that the label set does not have yet.

    `on_progress` hears of the frames done, earlier ones included, and of all. A frame that cannot be labelled
    is listed in the summary and costs no other; so is one that failed earlier, which is tried again only with
    `retry_failed`. `shard`: of all frames take this part.

    Raises BoxliftError where nothing can be labelled (no dataset, no prompts, no service), where the labels
    in `job.out` were made otherwise, and where a run has to stop; what is done by then stays done.
    """
    start = perf_counter()
    source = open_source(job.source)
    labels_of(job, source)  # raises where there are none
    chosen = source.names if names is None else list(dict.fromkeys(names))
    if not chosen:
        raise DatasetError(str(job.source), "there is no frame to label.", "Put point clouds into velodyne/.")
    if shard is not None:
        chosen = shard.of(chosen)
    identity = engine.identity(job)
    _make_folders(job.out)
    try:
        manifest, source_id = join_label_set(job, identity, source.layout)
    except OSError as error:
        problem = f"{str(job.out)!r} cannot be written ({error.strerror or error})."
        raise OptionsError("out", problem, "Give a folder or bucket to write to.") from None
    ledger = read_ledger(job.out / LEDGER, source_id)
    _refuse_foreign(chosen, ledger, manifest)
    summary = RunSummary()
    waiting = _anti_join(chosen, ledger, summary, retry_failed)
    on_progress(summary.before, len(chosen))
    writer = LedgerWriter(job.out / LEDGER)
    # Without a frame to label no worker starts: asking whether all is done is quick.
    reports = engine.run(job, waiting) if waiting else iter(())
    try:
        for report in reports:
            if report.fatal:
                raise RunStoppedError(f"The run stopped at frame {report.frame!r}: {report.sentence}")
            writer.add(LedgerRow.of(report, source_id, ledger.attempts(report.frame) + 1))
            summary.add(report)
            on_progress(summary.before + summary.counted, len(chosen))
    finally:
        if isinstance(reports, Generator):
            reports.close()  # ends the workers, also on Ctrl-C
        writer.flush()
    # Read again: other shards have written meanwhile.
    ledger = read_ledger(job.out / LEDGER)
    remove_leftovers(job.out, ledger.done)
    write_failed(job.out, ledger)
    summary.seconds = perf_counter() - start
    return summary


def detect_images(
    job: DetectJob,
    engine: DetectEngine,
    names: Sequence[str] | None = None,
    on_progress: OnProgress = lambda *_: None,
) -> RunSummary:
    """Find the objects of the images `names` (all where None) of a job, or lift its 2D boxes.

    As label_dataset, but without a ledger: every image is done anew. Raises BoxliftError where nothing can
    be done: no images, no model, no service.
    """
    start = perf_counter()
    folder = open_images(job.images, job.calib)
    if job.prompts is not None:
        find_labels(job.prompts, folder)
    chosen = folder.names if names is None else list(dict.fromkeys(names))
    _make_folders(job.out)
    on_progress(0, len(chosen))
    summary = RunSummary(noun="object")
    for report in engine.run(job, chosen):
        if report.fatal:
            raise RunStoppedError(f"The run stopped at image {report.frame!r}: {report.sentence}")
        summary.add(report)
        on_progress(summary.counted, len(chosen))
    summary.seconds = perf_counter() - start
    return summary


def _make_folders(out: AnyPath) -> None:
    """Where they are folders: an object store has none."""
    if not isinstance(out, Path):
        return
    try:
        for folder in ("data", "details"):
            (out / folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OptionsError(
            "out", f"{str(out)!r} cannot be made ({error.strerror}).", "Give a folder to write to."
        ) from None


def _refuse_foreign(chosen: Sequence[str], ledger: LedgerState, manifest: Manifest) -> None:
    """Two frames of one name would overwrite each other."""
    if not ledger.foreign:
        return
    clash = next((name for name in chosen if name in ledger.foreign), None)
    if clash is not None:
        paths = {entry.id: entry.path for entry in manifest.sources}
        theirs = paths.get(ledger.foreign[clash], "another data set")
        raise OptionsError(
            "out",
            f"the label set has a frame {clash!r} already, of {theirs}.",
            "Give another --out; where the data set has only moved, change its path in manifest.json.",
        )


def _anti_join(
    chosen: Sequence[str], ledger: LedgerState, summary: RunSummary, retry_failed: bool
) -> list[str]:
    """The frames that the ledger leaves to do; the others are told to the summary."""
    waiting = []
    for name in chosen:
        if (outcome := ledger.done.get(name)) is not None:
            summary.add_earlier(outcome)
        elif name in ledger.failed and not retry_failed:
            summary.add_earlier(Outcome.FAILED, FrameReport(name, Outcome.FAILED, ledger.failed[name][1]))
        else:
            waiting.append(name)
    return waiting
