"""Worker processes of one kind: work waits its turn; one that dies, hangs or falls silent is replaced."""

from __future__ import annotations

import asyncio
import logging
import os
from collections import Counter, deque
from collections.abc import AsyncIterator, Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from functools import partial
from time import monotonic, perf_counter
from typing import Any, Literal

from boxlift_service.problems import Kind, ProblemError
from boxlift_service.telemetry.metrics import Metrics, PoolState
from boxlift_service.workers.deadline import Deadline
from boxlift_service.workers.permits import Permits
from boxlift_service.workers.process import (
    BEAT_S,
    WorkerDiedError,
    WorkerGoneError,
    WorkerProcess,
)

_log = logging.getLogger("boxlift_service")

_SHORTEST_PAUSE_S, _LONGEST_PAUSE_S = 0.2, 30.0
# Work is given again where a worker ended before it began; what ends them all is the work's own fault.
_GIVEN_AT_MOST = 3
_REASONS = {"died": "died", "silent": "was not heard from", "late": "gave no answer in time"}
# A worker that opens loads libraries and models, and may be silent while it does.
_OPENING_TAKES_TIMES = 8


@dataclass(eq=False)
class _Job:
    """Work that waits or is computed; `file`, its descriptor, is its own."""

    work: Callable[..., Any]
    file: int | None
    result: asyncio.Future[tuple[Any, float]]
    queued: float = field(default_factory=perf_counter)
    given: int = 0

    def close(self) -> None:
        if self.file is not None:
            os.close(self.file)
            self.file = None


class _Worker:
    """A place in the pool: the process that has it now, and the thread that talks to it.

    Only the event loop changes what is here. _keep alone makes a place ready; it is no more when its process
    ends or loses its work. Who has the place changes while it is ready and not busy, in _swap alone.

    fresh: the process of a renewal, which waits for that.
    """

    def __init__(self, process: WorkerProcess[Any]) -> None:
        self.process = process
        self.fresh: WorkerProcess[Any] | None = None
        self.thread = ThreadPoolExecutor(1, thread_name_prefix="boxlift-worker")
        self.state: Literal["ready", "starting", "failed"] = "starting"
        self.failure: str | None = None
        self.busy = False
        self.ended = asyncio.Event()
        self.renewed = asyncio.Event()
        self.silent_beats = 0
        self.was_silent = False


class WorkerPool:
    """`count` processes of `new_process`, first come first served, within `permits`.

    greeting: work that every worker does once it is open; what it returns goes to `on_greeting`. A pool
    belongs to the event loop in which it is started.
    """

    def __init__(
        self,
        name: str,
        new_process: Callable[[], WorkerProcess[Any]],
        count: int,
        permits: Permits,
        metrics: Metrics,
        silence_s: float,
        *,
        greeting: Callable[[Any], Any] | None = None,
        on_greeting: Callable[[Any], None] = lambda _: None,
    ) -> None:
        self.name = name
        self.permits = permits
        self._new_process = new_process
        self._count = count
        self._metrics = metrics
        self._silence_s = silence_s
        self._greeting = greeting
        self._on_greeting = on_greeting
        self._waiting: deque[_Job] = deque()
        self._workers: list[_Worker] = []
        self._keeping: set[asyncio.Task[None]] = set()
        self._computing: set[asyncio.Task[None]] = set()
        self._retiring: set[asyncio.Task[None]] = set()
        metrics.watch_pool(name, self.state)

    def start(self) -> None:
        """Begin to open the workers."""
        self._workers = [_Worker(self._new_process()) for _ in range(self._count)]
        for worker in self._workers:
            _run(self._keep(worker), self._keeping)
        _run(self._listen(), self._keeping)

    async def stop(self) -> None:
        """Finish the work that runs, drop what waits, end the processes."""
        while self._waiting:
            self._waiting[0].result.cancel()
            self._forget(self._waiting[0])
        if self._computing:
            await asyncio.wait(self._computing)
        for task in self._keeping:
            task.cancel()
        await asyncio.gather(*self._keeping, return_exceptions=True)
        for worker in self._workers:
            if worker.fresh is not None:
                self._retire(worker.fresh)
        await asyncio.gather(
            *self._retiring, *(_in_thread(worker, worker.process.stop) for worker in self._workers)
        )
        for worker in self._workers:
            worker.thread.shutdown()

    def require_ready(self) -> None:
        """Raises ProblemError (503) unless every worker is open and was heard from."""
        if not self._workers:
            raise self._not_ready(f"The {self.name} workers are not started yet.")
        for worker in self._workers:
            if worker.state != "ready" or worker.was_silent:
                raise self._not_ready(worker.failure or f"A {self.name} worker is being started.")

    def require_room(self) -> None:
        """Raises ProblemError (429) where even the smallest work would be refused."""
        if self.permits.exhausted:
            self._metrics.count_refused(self.name, "too_busy")
            raise self.permits.refusal()

    @asynccontextmanager
    async def permitted(
        self, work: float, *, wait: bool = False, deadline: Deadline | None = None
    ) -> AsyncIterator[None]:
        """Permits for `work` while the body of the `async with` runs.

        Raises ProblemError: too few are left (429), the deadline passed, also while it waited for them (504).
        """
        try:
            if deadline is not None and deadline.seconds_left() <= 0:
                raise TimeoutError
            async with asyncio.timeout(None if deadline is None else deadline.seconds_left()):
                taken = await self.permits.take(work, wait=wait)
        except TimeoutError:
            assert deadline is not None
            self._metrics.count_dropped(self.name, "deadline")
            raise deadline.problem() from None
        except ProblemError:
            self._metrics.count_refused(self.name, "too_busy")
            raise
        try:
            yield
        finally:
            self.permits.give_back(taken)

    def state(self) -> PoolState:
        """What metrics tell of the pool."""
        states = [worker.state for worker in self._workers]
        return PoolState(
            permits=self.permits.total,
            permits_taken=self.permits.taken,
            queued=len(self._waiting),
            running=sum(worker.busy for worker in self._workers),
            workers=Counter(states),
            pids=tuple(worker.process.pid or 0 for worker in self._workers),
        )

    async def run(
        self, work: Callable[..., Any], file: int | None = None, deadline: Deadline | None = None
    ) -> tuple[Any, float]:
        """What `work` returns or raises in a worker (see WorkerProcess.call), and the seconds that it waited.

        `file` is closed once the work is done or dropped. Raises ProblemError: the worker was lost (500),
        none can work (503), the deadline passed (504).
        """
        job = _Job(work, file, asyncio.get_running_loop().create_future())
        self._waiting.append(job)
        self._refuse_if_none_works()
        self._dispatch()
        try:
            async with asyncio.timeout(None if deadline is None else deadline.seconds_left()) as limit:
                return await job.result
        except TimeoutError:
            if deadline is None or not limit.expired():
                raise
            self._metrics.count_dropped(self.name, "deadline")
            raise deadline.problem() from None
        except asyncio.CancelledError:
            self._metrics.count_dropped(self.name, "client_gone")
            raise
        finally:
            self._forget(job)

    async def renew(self, check: Callable[[Any], object]) -> None:
        """Replace all processes, each between two pieces of work, once all new ones are open. One at a time.

        check: work that a new one does first. Raises BoxliftError, WorkerDiedError or WorkerFaultError where
        one does not open or fails its check: the pool goes on with what it has.
        """
        opened: list[WorkerProcess[Any]] = []
        try:
            for _ in self._workers:
                opened.append(self._new_process())
                greeting = await asyncio.to_thread(self._open, opened[-1])
                await asyncio.to_thread(opened[-1].call, check)
        except BaseException:
            for process in opened:
                await asyncio.to_thread(process.stop)
            raise
        for worker, process in zip(self._workers, opened, strict=True):
            worker.fresh = process
            worker.renewed.clear()
            self._swap(worker)
        self._on_greeting(greeting)
        await asyncio.gather(*(worker.renewed.wait() for worker in self._workers))

    # One worker's life

    async def _keep(self, worker: _Worker) -> None:
        """Have a process at this place, always."""
        pause_s = _SHORTEST_PAUSE_S
        while True:
            worker.state, worker.silent_beats, worker.was_silent = "starting", 0, False
            worker.ended = ended = asyncio.Event()
            start = monotonic()
            try:
                greeting = await _in_thread(worker, partial(self._open, worker.process))
                self._watch(worker, ended)
            # Whatever it is (no memory, no threads, a broken installation), it may pass.
            except Exception as error:
                worker.failure = f"A {self.name} worker cannot start: {_last_line(error):.300}"
                _log.error("%s", worker.failure)
                worker.state = "failed"
                self._refuse_if_none_works()
                await asyncio.sleep(pause_s)
                pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)
                continue
            _log.info("a %s worker is ready after %.1f s", self.name, monotonic() - start)
            pause_s = _SHORTEST_PAUSE_S
            self._on_greeting(greeting)
            worker.state, worker.failure = "ready", None
            self._swap(worker)
            self._dispatch()
            await ended.wait()
            reason = "silent" if worker.was_silent else "late" if worker.process.late else "died"
            _log.error("a %s worker has to be replaced: it %s", self.name, _REASONS[reason])
            self._metrics.count_restart(self.name, reason)

    def _open(self, process: WorkerProcess[Any]) -> Any:
        process.start()
        return None if self._greeting is None else process.call(self._greeting)

    def _swap(self, worker: _Worker) -> None:
        """Give the place to the process of a renewal, where there is one and the place is ready."""
        if worker.fresh is None or worker.state != "ready" or worker.busy:
            return
        old, worker.process, worker.fresh = worker.process, worker.fresh, None
        worker.silent_beats, worker.was_silent = 0, False
        self._watch(worker, worker.ended)
        worker.renewed.set()
        self._metrics.count_restart(self.name, "reload")
        self._retire(old)

    def _retire(self, process: WorkerProcess[Any]) -> None:
        async def stop() -> None:
            await asyncio.to_thread(process.stop)

        _run(stop(), self._retiring)

    def _watch(self, worker: _Worker, ended: asyncio.Event) -> None:
        """Have `ended` set when the process that has this place now ends."""
        loop, process = asyncio.get_running_loop(), worker.process

        def end() -> None:
            if worker.process is process and worker.ended is ended:
                worker.state = "starting"
                ended.set()

        def on_end() -> None:
            if not loop.is_closed():
                loop.call_soon_threadsafe(end)

        process.watch(on_end)

    async def _listen(self) -> None:
        """End workers that are not heard from. Counts beats: in a machine that was paused nobody is late."""
        most = max(2, round(self._silence_s / BEAT_S))
        while True:
            await asyncio.sleep(BEAT_S)
            for worker in self._workers:
                if worker.process.pid is None or worker.process.heard():  # or it is not there yet
                    worker.silent_beats = 0
                    continue
                worker.silent_beats += 1
                if worker.silent_beats > (most if worker.state == "ready" else most * _OPENING_TAKES_TIMES):
                    worker.silent_beats, worker.was_silent = 0, True
                    worker.process.kill(f"it was not heard from for {self._silence_s:g} s and was ended.")

    # One piece of work

    def _dispatch(self) -> None:
        """Give what waits to who has nothing to do."""
        for worker in self._workers:
            if self._waiting and worker.state == "ready" and not worker.busy:
                worker.busy = True
                _run(self._compute(worker, self._waiting.popleft()), self._computing)

    async def _compute(self, worker: _Worker, job: _Job) -> None:
        waited_s = perf_counter() - job.queued
        job.given += 1
        try:
            answer = await _in_thread(worker, partial(worker.process.call, job.work, job.file))
        except WorkerDiedError as error:
            worker.state = "starting"
            if isinstance(error, WorkerGoneError) and job.given < _GIVEN_AT_MOST and not job.result.done():
                self._waiting.appendleft(job)  # it did not begin
            else:
                _settle(job.result, error=self._lost(error))
        except Exception as error:
            _settle(job.result, error=error)
        else:
            _settle(job.result, (answer, waited_s))
        finally:
            worker.busy = False
            if job not in self._waiting:
                job.close()
            self._swap(worker)
            self._dispatch()

    def _forget(self, job: _Job) -> None:
        """Nobody wants the result any more; what is computed already is computed to its end."""
        if job in self._waiting:
            self._waiting.remove(job)
            job.close()

    def _refuse_if_none_works(self) -> None:
        """Nothing waits for workers of which all failed."""
        if self._workers and all(worker.state == "failed" for worker in self._workers):
            while self._waiting:
                job = self._waiting.popleft()
                _settle(job.result, error=self._not_ready(self._workers[0].failure or "No worker works."))
                job.close()

    def _lost(self, error: WorkerDiedError) -> ProblemError:
        return ProblemError(
            Kind.WORKER_DIED,
            f"The {self.name} worker was lost with this request: {error}",
            "It is being replaced: send the request again. If that ends alike, the request is the cause.",
        )

    def _not_ready(self, reason: str) -> ProblemError:
        return ProblemError(
            Kind.NOT_READY, reason, "Try again in a few seconds.", headers={"Retry-After": "2"}
        )


async def _in_thread(worker: _Worker, work: Callable[[], Any]) -> Any:
    return await asyncio.get_running_loop().run_in_executor(worker.thread, work)


def _run(coroutine: Coroutine[Any, Any, None], tasks: set[asyncio.Task[None]]) -> None:
    """As a task that is held in `tasks` while it runs, and whose fault is logged."""
    task = asyncio.get_running_loop().create_task(coroutine)
    tasks.add(task)

    def on_done(task: asyncio.Task[None]) -> None:
        tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            _log.error("a task of the workers failed", exc_info=error)

    task.add_done_callback(on_done)


def _settle(
    future: asyncio.Future[tuple[Any, float]],
    result: tuple[Any, float] | None = None,
    *,
    error: BaseException | None = None,
) -> None:
    if future.done():  # its client is gone
        return
    if error is not None:
        future.set_exception(error)
    elif result is not None:
        future.set_result(result)


def _last_line(error: BaseException) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[-1]
