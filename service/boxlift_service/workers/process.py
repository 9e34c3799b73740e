"""A process that computes, beside the one that serves: what crashes or hangs there is replaced.

The worker is opened (its models load, and work once) before its first request. Requests come through a
pipe, one at a time: what to do as a pickle, and beside it the descriptor of the shared memory with the data.
A thread of the worker tells every half second that it runs; one that was stopped or starves is silent.
A worker ends with its parent, however that ends: its pipe closes.
"""

from __future__ import annotations

import atexit
import multiprocessing
import os
import signal
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkServerContext, SpawnContext
from multiprocessing.process import BaseProcess
from multiprocessing.reduction import recv_handle, send_handle
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

from boxlift.errors import BoxliftError

State = TypeVar("State")

BEAT_S = 0.5
_CONTEXTS: dict[str, SpawnContext | ForkServerContext] = {
    "spawn": multiprocessing.get_context("spawn"),
    "forkserver": multiprocessing.get_context("forkserver"),
}
_STOPS_WITHIN_S = 5.0
# Longest time to load libraries and models and to work once, on any machine.
_OPENS_WITHIN_S = 120.0


class WorkerDiedError(Exception):
    """The worker ended, or gave no answer in time and was ended."""


class WorkerGoneError(WorkerDiedError):
    """The worker had ended before it got the work; whoever else does it does it for the first time."""


class WorkerFaultError(Exception):
    """The worker lives; its code raised something that is no input's fault. Holds the traceback as text."""


class WorkerProcess(Generic[State]):
    """A process whose state is what `opener(*arguments)` returns there, first of all by start().

    opener: importable by name. method: how the process comes to be: "spawn", a new interpreter; "forkserver",
    a copy of a process that has loaded the libraries and computed nothing. Not for several threads at once,
    but for kill, heard, pid and late: whether the last process was ended since it gave no answer in time.
    """

    def __init__(
        self,
        opener: Callable[..., State],
        arguments: tuple[Any, ...],
        limit_s: float,
        *,
        method: Literal["spawn", "forkserver"] = "spawn",
        name: str = "boxlift-worker",
    ) -> None:
        self._opener = opener
        self._arguments = arguments
        self._limit_s = limit_s
        self._method = method
        self._name = name
        self._process: BaseProcess | None = None
        self._pipe: Connection | None = None
        self._pulse: Connection | None = None
        self._killed_because: str | None = None
        self.late = False
        self._pulse_lock = threading.Lock()

    @property
    def pid(self) -> int | None:
        """Number of the process, where there is one."""
        process = self._process
        return None if process is None else process.pid

    def watch(self, on_end: Callable[[], None]) -> None:
        """Call `on_end`, in a thread of its own, when the process that is there now has ended."""
        if self._process is None:
            return
        # Its own descriptor: the process may be closed while the thread waits.
        sentinel = os.dup(self._process.sentinel)

        def wait_for_end() -> None:
            try:
                wait([sentinel])
            finally:
                os.close(sentinel)
            on_end()

        threading.Thread(target=wait_for_end, daemon=True).start()

    def heard(self) -> bool:
        """Whether the process has told since the last call that it runs."""
        beats = 0
        with self._pulse_lock, suppress(OSError, EOFError):  # it ends just now
            while self._pulse is not None and self._pulse.poll():
                self._pulse.recv_bytes()
                beats += 1
        return beats > 0

    def start(self) -> None:
        """Start the process, in place of the one before, and wait until it is open.

        Raises WorkerDiedError, WorkerFaultError or the BoxliftError of the opener.
        """
        self.stop()
        context = _CONTEXTS[self._method]
        atexit.register(self.stop)  # it ignores SIGTERM, by which multiprocessing would end it
        self._pipe, theirs = context.Pipe()
        pulse, their_pulse = context.Pipe(duplex=False)
        self._killed_because, self.late = None, False
        self._process = context.Process(
            target=_work,
            args=(self._name, theirs, their_pulse, self._opener, self._arguments),
            name=self._name,
            daemon=True,
        )
        try:
            self._process.start()
            theirs.close()
            their_pulse.close()
            self._pulse = pulse
            with self._limit(_OPENS_WITHIN_S):
                self._answer()
        except (EOFError, ConnectionError) as error:  # of the server that forks
            self.stop()
            raise WorkerDiedError(f"it could not be started ({type(error).__name__}).") from None
        except BaseException:
            self.stop()
            raise

    def call(self, work: Callable[..., Any], file: int | None = None) -> Any:
        """What `work`, a picklable object, returns or raises for the state: `work(state)`.

        With `file`, a descriptor, `work(state, file)`: it is open there while the work is done. Raises
        WorkerDiedError, WorkerFaultError or the BoxliftError of the work.
        """
        if self._pipe is None or self._process is None or self._process.pid is None:
            raise WorkerGoneError("the worker has not been started.")
        with self._limit(self._limit_s):
            try:
                self._pipe.send((work, file is not None))
                if file is not None:
                    send_handle(self._pipe, file, self._process.pid)
                self._pipe.recv_bytes()  # it has the work
            except (OSError, EOFError, RuntimeError):  # the last: it acknowledged no descriptor
                raise WorkerGoneError(str(self._died())) from None
            return self._answer()

    def kill(self, because: str) -> None:
        """End the process from any thread; its request fails with this sentence."""
        process = self._process
        self._killed_because = because
        if process is not None:
            with suppress(ValueError, OSError, AttributeError):  # it is being started, or was just closed
                process.kill()

    def stop(self) -> None:
        """End the process; it is given no time to finish what it does."""
        atexit.unregister(self.stop)
        pipe, process, self._pipe, self._process = self._pipe, self._process, None, None
        if pipe is not None:
            pipe.close()
        with self._pulse_lock:
            if self._pulse is not None:
                self._pulse.close()
                self._pulse = None
        if process is not None and process.pid is not None:
            process.kill()
            process.join(_STOPS_WITHIN_S)
            with suppress(ValueError):  # it has not ended: the kernel will see to it
                process.close()

    @contextmanager
    def _limit(self, seconds: float) -> Iterator[None]:
        """End the process if the body of the `with` takes longer than it may; its pipe breaks then."""

        def end_late() -> None:
            self.late = True
            self.kill(f"it gave no answer within {seconds:g} s and was ended.")

        timer = threading.Timer(seconds, end_late)
        timer.daemon = True
        timer.start()
        try:
            yield
        finally:
            timer.cancel()

    def _answer(self) -> Any:
        assert self._pipe is not None
        try:
            answered, value = self._pipe.recv()
        except (EOFError, OSError):
            raise self._died() from None
        if answered:
            return value
        raise value if isinstance(value, BoxliftError) else WorkerFaultError(value)

    def _died(self) -> WorkerDiedError:
        assert self._process is not None
        self._process.join(_STOPS_WITHIN_S)
        code, because = self._process.exitcode, self._killed_because
        self.stop()
        if because is not None:
            return WorkerDiedError(because)
        if code is not None and code < 0:
            return WorkerDiedError(f"it was ended by {signal.Signals(-code).name}.")
        return WorkerDiedError(f"it ended with status {code}.")


def _work(
    name: str, pipe: Connection, pulse: Connection, opener: Callable[..., Any], arguments: tuple[Any, ...]
) -> None:
    """In the worker: open, then answer until the pipe closes."""
    with suppress(OSError):  # what ps and top show, on Linux
        Path("/proc/self/comm").write_text(name)
        # Where memory runs out, the kernel ends a worker, which is replaced, and not the server.
        Path("/proc/self/oom_score_adj").write_text("500")
    # Ctrl-C and the signals of a service manager reach the whole group; the parent finishes its requests.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    threading.Thread(target=_beat, args=(pulse,), daemon=True).start()
    state: Any = None
    try:
        opened, answer = _attempt(opener, *arguments)
        if opened:
            state, answer = answer, None
        pipe.send((opened, answer))
        while opened:
            work, has_file = pipe.recv()
            file = recv_handle(pipe) if has_file else None
            pipe.send_bytes(b"!")
            try:
                answer = _attempt(work, state) if file is None else _attempt(work, state, file)
            finally:
                if file is not None:
                    os.close(file)
            pipe.send(answer)
            del work, answer  # hundreds of megabytes at worst, not to be held until the next request
    except (EOFError, OSError):  # the parent is gone, or wants no more
        return


def _beat(pulse: Connection) -> None:
    """Tell that this process runs; end it when nobody wants to hear that any more."""
    with suppress(OSError):
        while True:
            pulse.send_bytes(b"!")
            time.sleep(BEAT_S)
    os._exit(1)  # whoever listened is gone, and the work may hang


def _attempt(work: Callable[..., Any], *arguments: Any) -> tuple[bool, Any]:
    """(True, what it returned), (False, its BoxliftError) or (False, the traceback of a fault)."""
    try:
        return True, work(*arguments)
    except BoxliftError as error:
        return False, error
    # Whatever it is, the parent tells it, and the next request is another one.
    except Exception:
        return False, traceback.format_exc()
