"""One input at a time: it must be decoded or refused, quietly, soon and in little memory."""

from __future__ import annotations

import resource
import signal
import time
import traceback
import tracemalloc
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from types import FrameType

from boxlift.errors import InputError

# Processor time that an input may take, whatever its size, and more for each byte.
_SLOW_S = 0.25
_SLOW_S_PER_BYTE = 1e-6
_HANGING_S = 2
# How far an input may raise the highest memory of the process: a few images or arrays at their limits, and
# what deflate can make of its bytes.
_LARGE_BYTES = 2**25
_LARGE_TIMES = 1_200


class FindingError(Exception):
    """What no input may do; the text says what it did."""


@dataclass
class Tally:
    """What became of the inputs so far."""

    inputs: int = 0
    accepted: int = 0
    refused: int = 0
    slowest_s: float = 0.0
    peak_bytes: int = 0


class Trial:
    """Gives inputs to `decode`, counts what became of them and raises FindingError."""

    def __init__(self, decode: Callable[[bytes], None]) -> None:
        self._decode = decode
        self.tally = Tally()

    def examine(self, data: bytes) -> None:
        """Give it one input. Raises FindingError."""
        memory_before = _highest_memory()
        start = time.thread_time()
        accepted = self._accepts(data)
        seconds = time.thread_time() - start
        if seconds > _SLOW_S:  # again, as a busy machine is slow too
            start = time.thread_time()
            self._accepts(data)
            seconds = min(seconds, time.thread_time() - start)
        grown = _highest_memory() - memory_before
        tally = self.tally
        tally.inputs += 1
        tally.accepted += accepted
        tally.refused += not accepted
        tally.slowest_s = max(tally.slowest_s, seconds)
        tally.peak_bytes += grown
        if seconds > _SLOW_S + _SLOW_S_PER_BYTE * len(data):
            raise FindingError(f"it takes {seconds:.2f} s ({len(data)} bytes)")
        _check_memory(grown, data)

    def _accepts(self, data: bytes) -> bool:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                self._decode(data)
                accepted = True
            except InputError as error:
                _check_refusal(error)
                accepted = False
            except FindingError:
                raise
            except Exception as error:
                where = traceback.extract_tb(error.__traceback__)[-1]
                raise FindingError(
                    f"{type(error).__name__}: {error!s:.200} ({where.filename}:{where.lineno})"
                ) from error
        if caught:
            raise FindingError(
                f"warning: {caught[0].message!s:.200} ({caught[0].filename}:{caught[0].lineno})"
            )
        return accepted


def _check_refusal(error: InputError) -> None:
    """A refusal is short, printable and is not the answer to what went wrong in the machine."""
    text = str(error)
    if len(text) > 1000 or not all(character.isprintable() for character in text):
        raise FindingError(f"the refusal is not fit to print: {text!r:.300}")
    if not (error.field and error.problem and error.remedy):
        raise FindingError(f"the refusal is incomplete: {text!r:.300}")
    if any(name in error.problem for name in ("MemoryError", "RecursionError", "Warning", "AttributeError")):
        raise FindingError(f"an error was hidden: {text:.300}")


def check_traced_memory(decode: Callable[[bytes], None], data: bytes) -> None:
    """As Trial judges memory, but of Python and NumPy alone, whatever the process had before; slow."""
    tracemalloc.start()
    try:
        with suppress(InputError):
            decode(data)
        _check_memory(tracemalloc.get_traced_memory()[1], data)
    finally:
        tracemalloc.stop()


def _check_memory(taken: int, data: bytes) -> None:
    if taken > _LARGE_BYTES + _LARGE_TIMES * len(data):
        raise FindingError(f"it takes {taken} bytes of memory ({len(data)} bytes)")


@contextmanager
def no_hanging() -> Iterator[None]:
    """Within it, an input that takes two seconds is a FindingError, where Python gets to see the signal."""

    def on_alarm(_: int, __: FrameType | None) -> None:
        raise FindingError(f"it takes more than {_HANGING_S} s")

    before = signal.signal(signal.SIGALRM, on_alarm)
    signal.alarm(_HANGING_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def _highest_memory() -> int:
    """Bytes of the highest memory of this process so far."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
