"""A place for a worker: whatever happens to the process that has it, there is soon another."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from time import monotonic
from typing import Any, Literal

from boxlift_service.telemetry.metrics import Metrics
from boxlift_service.workers.process import BEAT_S, WorkerDiedError, WorkerProcess

_log = logging.getLogger("boxlift_service")

_SHORTEST_PAUSE_S, _LONGEST_PAUSE_S = 0.2, 30.0
_REASONS = {"died": "died", "silent": "was not heard from", "late": "gave no answer in time"}
# A worker that opens loads libraries and models, and may be silent while it does.
_OPENING_TAKES_TIMES = 8


@dataclass(frozen=True)
class Staff:
    """What the workers of a pool are.

    greeting: work that every worker does once it is open; what it returns goes to `on_greeting`.
    """

    name: str
    new_process: Callable[[], WorkerProcess[Any]]
    silence_s: float
    greeting: Callable[[Any], Any] | None = None
    on_greeting: Callable[[Any], None] = lambda _: None

    def open(self, process: WorkerProcess[Any]) -> Any:
        """Start the process; returns its greeting."""
        process.start()
        return None if self.greeting is None else process.call(self.greeting)


class Place:
    """A place of `staff`: the process that has it now, and the thread that talks to it.

    Only the event loop changes what is here. _keep alone makes it ready; it is no more when its process
    ends or loses its work. Who has the place changes while it is ready and not busy, in _swap alone.
    `on_change` is called when it has become ready, or failed, since its process could not start.
    """

    def __init__(self, staff: Staff, metrics: Metrics, on_change: Callable[[], None]) -> None:
        self.state: Literal["ready", "starting", "failed"] = "starting"
        self.failure: str | None = None
        self.busy = False
        self.was_silent = False
        self._staff = staff
        self._metrics = metrics
        self._on_change = on_change
        self._process = staff.new_process()
        self._fresh: WorkerProcess[Any] | None = None  # of a renewal, which waits for its turn
        self._renewed = asyncio.Event()
        self._ended = asyncio.Event()
        self._silent_beats = 0
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="boxlift-worker")
        self._tasks: set[asyncio.Task[None]] = set()
        self._keeping = run_logged(self._keep(), self._tasks)

    @property
    def pid(self) -> int | None:
        """Number of the process, where there is one."""
        return self._process.pid

    async def call(self, work: Callable[..., Any], file: int | None) -> Any:
        """As WorkerProcess.call, for one piece of work at a time."""
        self.busy = True
        try:
            return await self._in_thread(partial(self._process.call, work, file))
        except WorkerDiedError:
            self.state = "starting"
            raise
        finally:
            self.busy = False
            self._swap()

    async def renew(self, process: WorkerProcess[Any]) -> None:
        """Give the place to `process`, which is open, as soon as there is nothing to do. One at a time."""
        self._fresh = process
        self._renewed.clear()
        self._swap()
        await self._renewed.wait()

    def listen(self) -> None:
        """End a process that was silent for too many beats; for every beat.

        Beats are counted, not seconds: in a machine that was paused nobody is late.
        """
        if self._process.pid is None or self._process.heard():  # or it is not there yet
            self._silent_beats = 0
            return
        self._silent_beats += 1
        most = max(2, round(self._staff.silence_s / BEAT_S))
        if self._silent_beats > (most if self.state == "ready" else most * _OPENING_TAKES_TIMES):
            self._silent_beats, self.was_silent = 0, True
            self._process.kill(f"it was not heard from for {self._staff.silence_s:g} s and was ended.")

    async def stop(self) -> None:
        """End the process, when it has done what it does."""
        self._keeping.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        if self._fresh is not None:
            await asyncio.to_thread(self._fresh.stop)
        await self._in_thread(self._process.stop)
        self._thread.shutdown()

    async def _keep(self) -> None:
        """Have a process, always."""
        name, pause_s = self._staff.name, _SHORTEST_PAUSE_S
        while True:
            self.state, self._silent_beats, self.was_silent = "starting", 0, False
            self._ended = ended = asyncio.Event()
            start = monotonic()
            try:
                greeting = await self._in_thread(partial(self._staff.open, self._process))
                self._watch()
            # Whatever it is (no memory, no threads, a broken installation), it may pass.
            except Exception as error:
                self.failure = f"A {name} worker cannot start: {_last_line(error):.300}"
                _log.error("%s", self.failure)
                self.state = "failed"
                self._on_change()
                await asyncio.sleep(pause_s)
                pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)
                continue
            _log.info("a %s worker is ready after %.1f s", name, monotonic() - start)
            pause_s = _SHORTEST_PAUSE_S
            self._staff.on_greeting(greeting)
            self.state, self.failure = "ready", None
            self._swap()
            self._on_change()
            await ended.wait()
            reason = "silent" if self.was_silent else "late" if self._process.late else "died"
            _log.error("a %s worker has to be replaced: it %s", name, _REASONS[reason])
            self._metrics.count_restart(name, reason)

    def _swap(self) -> None:
        """Give the place to the process of a renewal, where there is one and the place is ready."""
        if self._fresh is None or self.state != "ready" or self.busy:
            return
        old, self._process, self._fresh = self._process, self._fresh, None
        self._silent_beats, self.was_silent = 0, False
        self._watch()
        self._renewed.set()
        self._metrics.count_restart(self._staff.name, "reload")

        async def retire() -> None:
            await asyncio.to_thread(old.stop)

        run_logged(retire(), self._tasks)

    def _watch(self) -> None:
        """Have self._ended set when the process that has the place now ends."""
        loop, process, ended = asyncio.get_running_loop(), self._process, self._ended

        def end() -> None:
            # Else another process has the place, or this one has been started again.
            if self._process is process and self._ended is ended:
                self.state = "starting"
                ended.set()

        def on_end() -> None:
            if not loop.is_closed():
                loop.call_soon_threadsafe(end)

        process.watch(on_end)

    async def _in_thread(self, work: Callable[[], Any]) -> Any:
        return await asyncio.get_running_loop().run_in_executor(self._thread, work)


def run_logged(coroutine: Coroutine[Any, Any, None], tasks: set[asyncio.Task[None]]) -> asyncio.Task[None]:
    """As a task that is held in `tasks` while it runs, and whose fault is logged."""
    task = asyncio.get_running_loop().create_task(coroutine)
    tasks.add(task)

    def on_done(task: asyncio.Task[None]) -> None:
        tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            _log.error("a task of the workers failed", exc_info=error)

    task.add_done_callback(on_done)
    return task


def _last_line(error: BaseException) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[-1]
