"""Worker processes on this machine, each with a labeller, and where it is needed a detector, of its own.

Processes also for one worker: whatever takes a worker down (a crash in native code, the kernel short of
memory) costs that one frame and nothing else.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import Connection

from boxlift.errors import ModelFileError
from boxlift.formats.details import FrameDetails
from boxlift.frame import Frame
from boxlift_client.errors import WorkersCannotStartError
from boxlift_client.job import FrameReport, FrameWorker, LabelJob, Outcome

_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
# A worker holds about half a gigabyte: more of them are asked for by name.
_MOST_WORKERS_UNASKED = 8
# Starting a worker takes as long as labelling about this many frames.
_FRAMES_WORTH_A_WORKER = 8
_DIED = (
    "The worker process died while it labelled this frame (a crash in native code, or killed for lack of "
    "memory). Try it with --workers 1; if it dies again, leave the frame out with --frames."
)


class LocalEngine:
    """A pool of `workers` processes; without a number as many as cores, fewer for few frames."""

    def __init__(self, workers: int | None = None) -> None:
        self._workers = workers

    def run(self, job: LabelJob, names: Sequence[str]) -> Iterator[FrameReport]:
        """See Engine.run."""
        workers = self._workers or _workers_for(len(names))
        waiting = deque(names)
        while waiting:
            suspects = yield from _map(job, waiting, workers, in_flight_limit=2 * workers)
            # A worker died. Alone in a pool each suspect either comes through or convicts itself.
            alone = deque(suspects)
            while alone:
                for name in (yield from _map(job, alone, workers=1, in_flight_limit=1)):
                    yield FrameReport(name, Outcome.FAILED, _DIED)


def _workers_for(frame_count: int) -> int:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(cores, _MOST_WORKERS_UNASKED, frame_count // _FRAMES_WORTH_A_WORKER))


def _map(
    job: LabelJob, waiting: deque[str], workers: int, in_flight_limit: int
) -> Generator[FrameReport, None, list[str]]:
    """Label `waiting` until it is empty or a worker dies; returns the frames that were then in flight."""
    in_flight: dict[Future[FrameReport], str] = {}
    context = multiprocessing.get_context("spawn")
    lifeline, held_end = context.Pipe(duplex=False)
    pool = ProcessPoolExecutor(workers, context, initializer=_start_worker, initargs=(job, lifeline))
    try:
        _await_first_worker(pool)
        while waiting or in_flight:
            while waiting and len(in_flight) < in_flight_limit:
                with _single_threaded_children():
                    in_flight[pool.submit(_label_one, waiting[0])] = waiting[0]
                waiting.popleft()
            done, _ = wait(in_flight, return_when=FIRST_COMPLETED)
            # Those that finished before the pool broke come first, so that none of them is lost.
            for future in sorted(done, key=lambda future: future.exception() is not None):
                report = future.result()
                del in_flight[future]
                yield report
    except BrokenProcessPool:
        return list(in_flight.values())
    except BaseException:  # Ctrl-C above all: what a worker still does is of no use, and might hang
        held_end.close()
        raise
    finally:
        pool.shutdown(cancel_futures=True)
        held_end.close()
        lifeline.close()
    return []


def _await_first_worker(pool: ProcessPoolExecutor) -> None:
    try:
        with _single_threaded_children():
            first = pool.submit(_why_not_ready)
        reason = first.result()
    except BrokenProcessPool:
        reason = (
            "the processes end as soon as they start. Out of memory? A script that labels "
            "needs `if __name__ == '__main__':` around its calls."
        )
    if isinstance(reason, ModelFileError):
        raise reason
    if reason is not None:
        raise WorkersCannotStartError(f"The local workers cannot start: {reason}")


@contextmanager
def _single_threaded_children() -> Iterator[None]:
    """Processes that are started here (by `submit`) compute in one thread each.

    Frames are many and their arrays small: processes scale, while threads within one wait for each
    other, busily. The libraries read these variables as they load, before any code of ours runs there.
    """
    before = {name: os.environ.get(name) for name in _THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(_THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


_worker: FrameWorker | None = None
_not_ready: str | ModelFileError = "the worker was not initialised."


def _start_worker(job: LabelJob, lifeline: Connection) -> None:
    """In a new worker process: a labeller, or the reason why there is none."""
    global _worker, _not_ready
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()
    try:
        from boxlift.extras import open3d

        open3d()
        label = _labeller(job)
    except ImportError as error:
        _not_ready = str(error)
    except ModelFileError as error:
        _not_ready = error
    else:
        _worker = FrameWorker(job, label)


def _labeller(job: LabelJob) -> Callable[[Frame], FrameDetails]:
    """Frame -> details, with the prompts that it has or, in a job that detects, with those that it finds."""
    from boxlift.formats.details import details_of
    from boxlift.labeller import Labeller

    labeller = Labeller(job.settings)
    if not job.detects:
        return lambda frame: details_of(labeller.label(frame))
    from boxlift.detector import Detector, find_prompts

    detector = Detector.open(job.detector, threads=1)

    def label(frame: Frame) -> FrameDetails:
        prompted = find_prompts(frame, detector, job.settings.detection)
        return details_of(labeller.label(prompted), detector.digest)

    return label


def _end_with(lifeline: Connection) -> None:
    """End this process when the parent lets go of its end, also by being killed."""
    lifeline.poll(None)
    os._exit(1)


def _why_not_ready() -> str | ModelFileError | None:
    return None if _worker else _not_ready


def _label_one(name: str) -> FrameReport:
    if _worker is None:
        return FrameReport(name, Outcome.FAILED, str(_not_ready))
    return _worker.label_one(name)
