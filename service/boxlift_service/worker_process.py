"""A process that computes, beside the one that serves: what crashes or hangs there is replaced.

The worker is opened (its models load, and work once) before its first request. Requests and answers are
pickled through a pipe, one at a time. A worker ends with its parent, however that ends: its pipe closes.
"""

from __future__ import annotations

import atexit
import multiprocessing
import signal
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any, Generic, TypeVar

from boxlift.errors import BoxliftError

State = TypeVar("State")

_STOPS_WITHIN_S = 5.0


class WorkerDiedError(Exception):
    """The worker ended, or gave no answer in time and was ended."""


class WorkerFaultError(Exception):
    """The worker lives; its code raised something that is no input's fault. Holds the traceback as text."""


class WorkerProcess(Generic[State]):
    """A process whose state is what `opener(*arguments)` returns there, first of all by start().

    opener: importable by name. Not for several threads at once.
    """

    def __init__(self, opener: Callable[..., State], arguments: tuple[Any, ...], deadline_s: float) -> None:
        self._opener = opener
        self._arguments = arguments
        self._deadline_s = deadline_s
        self._process: SpawnProcess | None = None
        self._pipe: Connection | None = None
        self._late = False

    @property
    def lives(self) -> bool:
        """Whether there is a process that was opened and has not ended."""
        # Not is_alive: a process lets go of its sentinel a moment before it can be waited for.
        return self._process is not None and not wait([self._process.sentinel], timeout=0)

    def watch(self, on_end: Callable[[], None]) -> None:
        """Call `on_end`, in a thread of its own, when the process that is there now has ended."""
        if self._process is None:
            return
        sentinel = self._process.sentinel

        def wait_for_end() -> None:
            wait([sentinel])
            on_end()

        threading.Thread(target=wait_for_end, daemon=True).start()

    def start(self) -> None:
        """Start the process, in place of the one before, and wait until it is open.

        Raises WorkerDiedError, WorkerFaultError or the BoxliftError of the opener.
        """
        self.stop()
        context = multiprocessing.get_context("spawn")
        atexit.register(self.stop)  # it ignores SIGTERM, by which multiprocessing would end it
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(
            target=_work, args=(theirs, self._opener, self._arguments), name="boxlift-detection", daemon=True
        )
        try:
            self._process.start()
            theirs.close()
            with self._deadline():
                self._answer()
        except BaseException:
            self.stop()
            raise

    def call(self, work: Callable[[State], Any]) -> Any:
        """What `work` returns or raises for the state; `work` is a picklable object.

        Raises WorkerDiedError, WorkerFaultError or the BoxliftError of the work.
        """
        if self._pipe is None:
            raise WorkerDiedError("the worker has not been started.")
        with self._deadline():
            try:
                self._pipe.send(work)
            except OSError:
                raise self._died() from None
            return self._answer()

    def stop(self) -> None:
        """End the process; it is given no time to finish what it does."""
        atexit.unregister(self.stop)
        pipe, process, self._pipe, self._process = self._pipe, self._process, None, None
        if pipe is not None:
            pipe.close()
        if process is not None and process.pid is not None:
            process.kill()
            process.join(_STOPS_WITHIN_S)
            process.close()

    @contextmanager
    def _deadline(self) -> Iterator[None]:
        """End the process if the body of the `with` takes longer than it may; its pipe breaks then."""
        assert self._process is not None
        self._late = False
        timer = threading.Timer(self._deadline_s, self._end_late, (self._process,))
        timer.daemon = True
        timer.start()
        try:
            yield
        finally:
            timer.cancel()

    def _end_late(self, process: SpawnProcess) -> None:
        self._late = True
        with suppress(ValueError):  # it has just been closed
            process.kill()

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
        code = self._process.exitcode
        self.stop()
        if self._late:
            return WorkerDiedError(f"it gave no answer within {self._deadline_s:g} s and was ended.")
        if code is not None and code < 0:
            return WorkerDiedError(f"it was ended by {signal.Signals(-code).name}.")
        return WorkerDiedError(f"it ended with status {code}.")


def _work(pipe: Connection, opener: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    """In the worker: open, then answer until the pipe closes."""
    # Ctrl-C and the signals of a service manager reach the whole group; the parent finishes its requests.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    state: Any = None
    try:
        opened, answer = _attempt(opener, *arguments)
        if opened:
            state, answer = answer, None
        pipe.send((opened, answer))
        while opened:
            pipe.send(_attempt(pipe.recv(), state))
    except (EOFError, OSError):  # the parent is gone, or wants no more
        return


def _attempt(work: Callable[..., Any], *arguments: Any) -> tuple[bool, Any]:
    """(True, what it returned), (False, its BoxliftError) or (False, the traceback of a fault)."""
    try:
        return True, work(*arguments)
    except BoxliftError as error:
        return False, error
    # Whatever it is, the parent tells it, and the next request is another one.
    except Exception:
        return False, traceback.format_exc()
