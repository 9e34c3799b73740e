"""Track the objects of a label set, drive by drive, into a label set of its own.

A drive is done when its record is there; one that was cut off is tracked again, into the same bytes.
"""

from __future__ import annotations

import errno
import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from boxlift import __version__
from boxlift.errors import BoxliftError, DatasetError, MissingExtraError, OptionsError
from boxlift.label_sets.files import details_path, write_label_files
from boxlift.label_sets.index import LabelSetIndex, SweepEntry
from boxlift.label_sets.manifest import Manifest, read_manifest
from boxlift.label_sets.reader import LabelSetReader
from boxlift.settings import LabellerSettings
from boxlift_client.drive_record import (
    TRACKS,
    DriveCounts,
    DriveRecord,
    labels_digest,
    read_record,
    record_path,
    write_record,
)
from boxlift_client.errors import RunStoppedError
from boxlift_client.joining import join_tracked_set
from boxlift_client.leftovers import remove_leftovers
from boxlift_client.summary import counted

if TYPE_CHECKING:
    from boxlift.storage import AnyPath
    from boxlift.tracking import Fill, Poses
    from boxlift_client.shard import Shard

# Called with the frames done so far and all frames.
OnProgress = Callable[[int, int], None]

_PRELOADED = "boxlift.tracking"


@dataclass(frozen=True)
class TrackJob:
    """What is tracked, how, and where to.

    source: the data set, where it is not where it was labelled. poses, fill: see boxlift.tracking.
    """

    label_set: AnyPath
    out: AnyPath
    source: AnyPath | None = None
    poses: Poses = "matched"
    fill: Fill = "gaps"


@dataclass
class TrackSummary:
    """The records of all drives, those of earlier runs included; drives that failed, and the sentence why."""

    records: list[DriveRecord] = field(default_factory=list)
    failed: list[tuple[str, str]] = field(default_factory=list)
    before: int = 0
    seconds: float = 0.0

    @property
    def complete(self) -> bool:
        """Whether no drive failed."""
        return not self.failed

    def text(self) -> str:
        """Plain text: what the frames said one by one, and what their drives say."""
        frames = sum(each.frames for each in self.records)
        lines = [f"{counted(len(self.records), 'drive')}, {counted(frames, 'frame')}; {self.seconds:.1f} s."]
        if self.before:
            lines.append(f"{counted(self.before, 'drive')} of them before this run.")
        motions = {
            motion: sum(each.objects.get(motion, 0) for each in self.records)
            for motion in ("static", "moving", "unknown")
        }
        lines.append(
            f"{counted(sum(motions.values()), 'object')}: {motions['static']} stand, "
            f"{motions['moving']} move, {motions['unknown']} were seen once."
        )
        before, after = (
            sum(getattr(each, name) for each in self.records) for name in ("boxes_before", "boxes_after")
        )
        given, filled, turned = (
            sum(getattr(each, name) for each in self.records) for name in ("given_a_box", "filled", "turned")
        )
        lines.append(
            f"Boxes: {before} before, {after} after: {counted(given, 'prompt')} got the box of a drive's "
            f"object, {counted(filled, 'gap')} filled; {turned} looked backwards and were turned."
        )
        lines += [_spread_sentence(each) for each in self.records if each.length_m is not None]
        lines += [f"  failed {drive}: {sentence}" for drive, sentence in self.failed]
        return "\n".join(lines)


def _spread_sentence(record: DriveRecord) -> str:
    spreads = [
        f"{what} {value:.2f} m"
        for what, value in (("standing places by", record.place_m), ("lengths by", record.length_m))
        if value is not None
    ]
    return (
        f"  {record.drive or 'drive'}: from frame to frame {' and '.join(spreads)} before, by nothing after."
    )


def track_label_set(
    job: TrackJob,
    on_progress: OnProgress = lambda *_: None,
    *,
    workers: int = 1,
    shard: Shard | None = None,
) -> TrackSummary:
    """Track every drive of a label set that `job.out` does not have yet. workers: drives at a time.

    A drive that cannot be tracked is told in the summary and costs no other. Raises BoxliftError where
    nothing can be tracked (no label set, no data set), where what is in `job.out` was made otherwise, and
    where a run has to stop; what is done by then stays done. Raises OSError.
    """
    start = perf_counter()
    LabelSetIndex.names_in(job.label_set)  # raises where there is no label set
    manifest = read_manifest(job.label_set)
    if manifest is None or manifest.tracking is not None:
        problem = "is tracked already" if manifest else "has no manifest, as those of boxlift label have"
        raise DatasetError(
            str(job.label_set), f"the label set {problem}.", "Give one that boxlift label wrote."
        )
    if job.out == job.label_set:
        raise OptionsError("out", f"{str(job.out)!r} is the label set itself.", "Give another folder.")
    LabelSetReader(job.label_set, manifest, job.source).check()
    drives = _drives(job.label_set)
    if shard is not None:
        drives = {name: drives[name] for name in shard.of(drives)}
    if isinstance(job.out, Path):
        for folder in ("data", "details"):
            (job.out / folder).mkdir(parents=True, exist_ok=True)
    tracking = {"version": __version__, "poses": job.poses, "fill": job.fill}
    join_tracked_set(job.out, manifest, tracking)
    summary = TrackSummary()
    waiting = _anti_join(job, drives, summary)
    progress = _Progress(sum(_count(entries) for entries in drives.values()), on_progress)
    progress.finish(sum(record.frames for record in summary.records))
    for drive, result, frames in _tracked(job, manifest, waiting, workers, progress.tell):
        if isinstance(result, DriveRecord):
            summary.records.append(result)
        else:
            summary.failed.append((drive or "drive", result))
        progress.finish(frames)
    recorded = {record.drive for record in summary.records}
    remove_leftovers(
        job.out, {name for drive in recorded for entry in drives[drive] for name in entry.frames}
    )
    remove_leftovers(job.out, {record_path(job.out, drive).stem for drive in recorded}, [TRACKS])
    summary.records.sort(key=lambda record: record.drive)
    summary.seconds = perf_counter() - start
    return summary


class _Progress:
    """Frames of finished drives, and of the one at work."""

    def __init__(self, total: int, on_progress: OnProgress) -> None:
        self._total, self._on_progress, self._finished = total, on_progress, 0

    def finish(self, frames: int) -> None:
        self._finished += frames
        self.tell(0)

    def tell(self, frames: int) -> None:
        self._on_progress(self._finished + frames, self._total)


def _drives(label_set: AnyPath) -> dict[str, list[SweepEntry]]:
    drives: dict[str, list[SweepEntry]] = {}
    for entry in LabelSetIndex(label_set).sweeps:
        drives.setdefault(entry.log, []).append(entry)
    return drives


def _anti_join(
    job: TrackJob, drives: dict[str, list[SweepEntry]], summary: TrackSummary
) -> list[tuple[str, list[SweepEntry]]]:
    """The drives that are to be tracked; the records of the others are told to the summary."""
    waiting = []
    for drive, entries in drives.items():
        record = read_record(job.out, drive)
        if record is not None and record.labels == _digest(job.label_set, entries):
            summary.records.append(record)
            summary.before += 1
        else:
            waiting.append((drive, entries))
    return waiting


def _digest(label_set: AnyPath, entries: Sequence[SweepEntry]) -> str:
    return labels_digest(details_path(label_set, name) for entry in entries for name in entry.frames)


def _tracked(
    job: TrackJob,
    manifest: Manifest,
    waiting: Sequence[tuple[str, list[SweepEntry]]],
    workers: int,
    on_frames: Callable[[int], None],
) -> Iterator[tuple[str, DriveRecord | str, int]]:
    """(drive, record or the sentence why there is none, frames) of each as it is finished."""
    if min(workers, len(waiting)) <= 1:
        for drive, entries in waiting:
            yield drive, track_drive(job, manifest, drive, entries, on_frames), _count(entries)
        return
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([_PRELOADED])
    with ProcessPoolExecutor(min(workers, len(waiting)), context, initializer=one_thread) as pool:
        drive_of = {pool.submit(track_drive, job, manifest, *each): each for each in waiting}
        try:
            for future in as_completed(drive_of):
                drive, entries = drive_of[future]
                yield drive, future.result(), _count(entries)
        except BrokenProcessPool:
            problem = "A process was killed, perhaps for want of memory; the same command goes on."
            raise RunStoppedError(problem) from None
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _count(entries: Sequence[SweepEntry]) -> int:
    return sum(len(entry.frames) for entry in entries)


def one_thread() -> None:
    """For processes of ours: threads of torch that wait for each other cost a busy machine seconds."""
    import torch

    torch.set_num_threads(1)


def track_drive(
    job: TrackJob,
    manifest: Manifest,
    drive: str,
    entries: Sequence[SweepEntry],
    on_frames: Callable[[int], None] = lambda _: None,
) -> DriveRecord | str:
    """Track one drive and write its frames and record; or the sentence why it has none.

    Raises RunStoppedError where no other drive would fare better.
    """
    from boxlift.tracking import DriveTracker, SweepFrames

    try:
        labels = _digest(job.label_set, entries)
        reader = LabelSetReader(job.label_set, manifest, job.source)
        settings = LabellerSettings.model_validate(manifest.settings)
        tracker = DriveTracker(settings, job.poses, job.fill)
        sweeps = [SweepFrames(entry.frames, entry.timestamp_ns) for entry in entries]
        counts = DriveCounts()
        for details in tracker.track(sweeps, reader):
            write_label_files(job.out, details.frame, details)
            counts.add(details)
            on_frames(counts.frames)
        record = counts.record(drive, labels, tracker.objects)
        write_record(job.out, record)
        return record
    except MissingExtraError:
        raise
    except Exception as error:
        # One drive's surprise must not cost the others; a full disk is everybody's.
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise RunStoppedError(f"The run stopped at drive {drive!r}: {error}") from None
        return str(error) if isinstance(error, BoxliftError) else f"{type(error).__name__}: {error}"
