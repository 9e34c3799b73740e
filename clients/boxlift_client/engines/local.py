"""Worker processes on this machine, each with a labeller, and where it is needed a detector, of its own.

Processes also for one worker: whatever takes a worker down (a crash in native code, the kernel short of
memory) costs that one frame another try and nothing else. They are forked from a server that has loaded the
libraries, so that they start in a blink and share its memory.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkServerContext
from multiprocessing.process import BaseProcess

from boxlift.errors import BoxliftError
from boxlift_client.engines import LabellerIdentity, own_identity
from boxlift_client.engines.dispatch import Died, Done, Ready, dispatch
from boxlift_client.engines.worker_process import MakeWorker, frame_worker, work
from boxlift_client.job import FrameReport, LabelJob

_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_PRELOADED = "boxlift_client.engines.preloaded"
# A worker holds about half a gigabyte: more of them are asked for by name.
_MOST_WORKERS_UNASKED = 8
# Starting a worker takes as long as labelling about this many frames.
_FRAMES_WORTH_A_WORKER = 8


class LocalEngine:
    """`workers` processes; without a number as many as cores, fewer for few frames.

    make_worker: what labels in each of them.
    """

    def __init__(self, workers: int | None = None, make_worker: MakeWorker = frame_worker) -> None:
        self._workers = workers
        self._make_worker = make_worker

    def identity(self, job: LabelJob) -> LabellerIdentity:
        """See Engine.identity. Raises ModelFileError."""
        return own_identity(job)

    def run(self, job: LabelJob, names: Sequence[str]) -> Iterator[FrameReport]:
        """See Engine.run."""
        workers = self._workers or _workers_for(len(names))
        crew = _ProcessCrew(job, self._make_worker)
        try:
            yield from dispatch(crew, names, min(workers, len(names)), job.frame_timeout_s)
        finally:
            crew.close()


def _workers_for(frame_count: int) -> int:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(cores, _MOST_WORKERS_UNASKED, frame_count // _FRAMES_WORTH_A_WORKER))


class _ProcessCrew:
    """Crew of processes, known by the runner's end of their pipe."""

    def __init__(self, job: LabelJob, make_worker: MakeWorker) -> None:
        self._job = job
        self._make_worker = make_worker
        self._context = _fork_server()
        # Held by the runner alone: when it ends, in whatever way, the workers see the other end close.
        self._lifeline, self._held_end = self._context.Pipe(duplex=False)
        self._processes: dict[Connection, BaseProcess] = {}
        self._ready: set[Connection] = set()

    def start(self) -> Connection:
        ours, theirs = self._context.Pipe()
        with _single_threaded_children():
            process = self._context.Process(
                target=work,
                args=(self._make_worker, self._job, theirs, self._lifeline, dict(os.environ)),
                daemon=True,
            )
            process.start()
        theirs.close()
        self._processes[ours] = process
        return ours

    def give(self, worker: Connection, name: str) -> None:
        try:
            worker.send(name)
        except OSError:  # it has just died, and wait() will find out
            return

    def wait(self, timeout_s: float) -> list[Ready[Connection] | Done[Connection] | Died[Connection]]:
        events: list[Ready[Connection] | Done[Connection] | Died[Connection]] = []
        for pipe in wait(list(self._processes), timeout_s):
            assert isinstance(pipe, Connection)
            try:
                message: FrameReport | BoxliftError | str | None = pipe.recv()
            except (EOFError, OSError):
                self.end(pipe)
                events.append(Died(pipe))
                continue
            if isinstance(message, FrameReport):
                events.append(Done(pipe, message))
            else:
                events.append(Ready(pipe, message))
        return events

    def end(self, worker: Connection) -> None:
        process = self._processes.pop(worker)
        process.kill()
        process.join()
        process.close()
        worker.close()

    def close(self) -> None:
        self._held_end.close()
        self._lifeline.close()


def _fork_server() -> ForkServerContext:
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([_PRELOADED])
    return context


@contextmanager
def _single_threaded_children() -> Iterator[None]:
    """Processes that are started here compute in one thread each.

    The libraries read these variables as they load, before any code of ours runs there.
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
