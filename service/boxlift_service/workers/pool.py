"""Work for worker processes of one kind: taken on within the permits, it waits its turn and is answered."""

from __future__ import annotations

import asyncio
import os
from collections import Counter, deque
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

from boxlift_service.problems import Kind, ProblemError
from boxlift_service.telemetry.metrics import Metrics, PoolState
from boxlift_service.workers.deadline import Deadline, within
from boxlift_service.workers.permits import Permits
from boxlift_service.workers.place import Place, Staff, run_logged
from boxlift_service.workers.process import BEAT_S, WorkerDiedError, WorkerGoneError, WorkerProcess

# Work is given again where a worker ended before it began; what ends them all is the work's own fault.
_GIVEN_AT_MOST = 3


@dataclass(eq=False)
class _Job:
    """Work that waits or is computed; `file`, its descriptor, is its own."""

    work: Callable[..., Any]
    file: int | None
    result: asyncio.Future[tuple[Any, float]]
    queued: float = field(default_factory=perf_counter)
    given: int = 0

    def settle(self, answer: Any, waited_s: float) -> None:
        if not self.result.done():  # else its client is gone
            self.result.set_result((answer, waited_s))

    def fail(self, error: BaseException) -> None:
        if not self.result.done():
            self.result.set_exception(error)

    def close(self) -> None:
        if self.file is not None:
            os.close(self.file)
            self.file = None


class WorkerPool:
    """`count` workers of `staff`, first come first served, within `permits`.

    A pool belongs to the event loop in which it is started.
    """

    def __init__(self, staff: Staff, count: int, permits: Permits, metrics: Metrics) -> None:
        self.name = staff.name
        self.permits = permits
        self._staff = staff
        self._count = count
        self._metrics = metrics
        self._waiting: deque[_Job] = deque()
        self._places: list[Place] = []
        self._computing: set[asyncio.Task[None]] = set()
        self._listening: set[asyncio.Task[None]] = set()
        metrics.watch_pool(self.name, self.state)

    def start(self) -> None:
        """Begin to open the workers."""
        self._places = [Place(self._staff, self._metrics, self._dispatch) for _ in range(self._count)]
        run_logged(self._listen(), self._listening)

    async def stop(self) -> None:
        """Finish the work that runs, drop what waits, end the processes."""
        while self._waiting:
            self._waiting[0].result.cancel()
            self._forget(self._waiting[0])
        if self._computing:
            await asyncio.wait(self._computing)
        for task in self._listening:
            task.cancel()
        await asyncio.gather(*self._listening, return_exceptions=True)
        await asyncio.gather(*(place.stop() for place in self._places))

    def require_ready(self) -> None:
        """Raises ProblemError (503) unless every worker is open and was heard from."""
        if not self._places:
            raise self._not_ready(f"The {self.name} workers are not started yet.")
        for place in self._places:
            if place.state != "ready" or place.was_silent:
                raise self._not_ready(place.failure or f"A {self.name} worker is being started.")

    def require_room(self) -> None:
        """Raises ProblemError (429) where even the smallest work would be refused."""
        if self.permits.exhausted:
            self._metrics.count_refused(self.name, "too_busy")
            raise self.permits.refusal()

    def state(self) -> PoolState:
        """What metrics tell of the pool."""
        return PoolState(
            permits=self.permits.total,
            permits_taken=self.permits.taken,
            queued=len(self._waiting),
            running=sum(place.busy for place in self._places),
            workers=Counter(place.state for place in self._places),
            pids=tuple(place.pid or 0 for place in self._places),
        )

    @asynccontextmanager
    async def permitted(
        self, work: float, *, wait: bool = False, deadline: Deadline | None = None
    ) -> AsyncIterator[None]:
        """Permits for `work` while the body of the `async with` runs.

        Raises ProblemError: too few are left (429), the deadline passed, also while it waited for them (504).
        """
        async with self._in_time(deadline):
            try:
                taken = await self.permits.take(work, wait=wait)
            except ProblemError:
                self._metrics.count_refused(self.name, "too_busy")
                raise
        try:
            yield
        finally:
            self.permits.give_back(taken)

    async def run(
        self, work: Callable[..., Any], file: int | None = None, deadline: Deadline | None = None
    ) -> tuple[Any, float]:
        """What `work` returns or raises in a worker (see WorkerProcess.call), and the seconds that it waited.

        `file` is closed once the work is done or dropped. Raises ProblemError: the worker was lost (500),
        none can work (503), the deadline passed (504).
        """
        job = _Job(work, file, asyncio.get_running_loop().create_future())
        self._waiting.append(job)
        try:
            async with self._in_time(deadline):
                self._dispatch()
                return await job.result
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
            for _ in self._places:
                opened.append(self._staff.new_process())
                greeting = await asyncio.to_thread(self._staff.open, opened[-1])
                await asyncio.to_thread(opened[-1].call, check)
        except BaseException:
            for process in opened:
                await asyncio.to_thread(process.stop)
            raise
        self._staff.on_greeting(greeting)
        await asyncio.gather(
            *(place.renew(process) for place, process in zip(self._places, opened, strict=True))
        )

    @asynccontextmanager
    async def _in_time(self, deadline: Deadline | None) -> AsyncIterator[None]:
        """As `within`; work that is dropped for it is counted."""
        try:
            async with within(deadline):
                yield
        except ProblemError as problem:
            if problem.kind is Kind.DEADLINE_EXCEEDED:
                self._metrics.count_dropped(self.name, "deadline")
            raise

    async def _listen(self) -> None:
        while True:
            await asyncio.sleep(BEAT_S)
            for place in self._places:
                place.listen()

    def _dispatch(self) -> None:
        """Give what waits to who has nothing to do; nothing waits for workers of which none can start."""
        for place in self._places:
            if self._waiting and place.state == "ready" and not place.busy:
                place.busy = True  # from now on, not from when the task begins
                run_logged(self._compute(place, self._waiting.popleft()), self._computing)
        if self._places and all(place.state == "failed" for place in self._places):
            while self._waiting:
                job = self._waiting.popleft()
                job.fail(self._not_ready(self._places[0].failure or "No worker works."))
                job.close()

    async def _compute(self, place: Place, job: _Job) -> None:
        waited_s = perf_counter() - job.queued
        job.given += 1
        try:
            job.settle(await place.call(job.work, job.file), waited_s)
        except WorkerDiedError as error:
            if isinstance(error, WorkerGoneError) and job.given < _GIVEN_AT_MOST and not job.result.done():
                self._waiting.appendleft(job)  # it did not begin
            else:
                job.fail(self._lost(error))
        except Exception as error:
            job.fail(error)
        finally:
            if job not in self._waiting:
                job.close()
            self._dispatch()

    def _forget(self, job: _Job) -> None:
        """Nobody wants the result any more; what is computed already is computed to its end."""
        if job in self._waiting:
            self._waiting.remove(job)
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
