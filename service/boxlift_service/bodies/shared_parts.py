"""The parts of a request in anonymous shared memory: written as they come in, read where they are computed.

The memory is a file without a name. A worker gets its descriptor, so nothing of a point cloud or an image
goes through a pickle; and whoever dies, the kernel frees it with the last process that has it open.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

from boxlift_service.problems import Kind, ProblemError


@dataclass(frozen=True)
class Part:
    """One field of a request; filename where the client sent it as a file."""

    data: bytes
    filename: str | None = None


@dataclass(frozen=True)
class _Span:
    """Where a part lies in the shared memory."""

    start: int
    size: int
    filename: str | None


@dataclass(frozen=True)
class PartsIndex:
    """Which parts lie where: what a worker needs beside the descriptor. Small, and made to be pickled."""

    spans: Mapping[str, tuple[_Span, ...]]

    def read(self, file: int) -> dict[str, tuple[Part, ...]]:
        """The parts by name, those of one name in their order."""
        return {
            name: tuple(Part(os.pread(file, span.size, span.start), span.filename) for span in spans)
            for name, spans in self.spans.items()
        }


class HeldBytes:
    """Counts the bytes of all requests that are held, and refuses what goes beyond the limit."""

    def __init__(self, limit: int, on_refused: Callable[[], None] = lambda: None) -> None:
        self._limit = limit
        self._on_refused = on_refused
        self.taken = 0

    def has_room(self, count: int) -> bool:
        """Whether `count` more may be held."""
        return self.taken + count <= self._limit

    def take(self, count: int) -> None:
        """Raises ProblemError (429) where there is no room for `count` more."""
        if not self.has_room(count):
            self._on_refused()
            raise ProblemError(
                Kind.TOO_BUSY,
                f"The bodies of other requests take up the {self._limit} bytes that are held at a time.",
                "Try again in a second.",
                headers={"Retry-After": "1"},
            )
        self.taken += count

    def give_back(self, count: int) -> None:
        """The counterpart of take."""
        self.taken -= count


class SharedParts:
    """Parts by name. Parts are written one after the other: `write` its bytes, then `end_part`.

    Close it, or use it as a context manager; what was handed to a worker stays open there.
    """

    def __init__(self, held: HeldBytes | None = None) -> None:
        self._file = _anonymous_file()
        self._held = held
        self._written = self._part_start = 0
        self._spans: dict[str, list[_Span]] = {}

    @classmethod
    def of(cls, parts: Mapping[str, Sequence[Part]], held: HeldBytes | None = None) -> Self:
        """From parts that are there already. Raises as `write`."""
        shared = cls(held)
        try:
            for name, sequence in parts.items():
                for part in sequence:
                    shared.write(part.data)
                    shared.end_part(name, part.filename)
        except BaseException:
            shared.close()
            raise
        return shared

    def write(self, data: bytes | memoryview) -> None:
        """Append to the part that is being written. Raises ProblemError (429) where there is no room."""
        if self._held is not None:
            self._held.take(len(data))
        self._written += len(data)
        left = memoryview(data)
        try:
            while left:
                left = left[os.write(self._file, left) :]
        except OSError as error:
            raise ProblemError(
                Kind.TOO_BUSY,
                f"There is no memory for the body ({error.strerror}).",
                "Try again in a second.",
                headers={"Retry-After": "1"},
            ) from None

    @property
    def part_size(self) -> int:
        """Bytes of the part that is being written."""
        return self._written - self._part_start

    def end_part(self, name: str, filename: str | None = None) -> None:
        """What was written since the part before is the next part of `name`."""
        span = _Span(self._part_start, self.part_size, filename)
        self._spans.setdefault(name, []).append(span)
        self._part_start = self._written

    def name_file(self, name: str, filename: str) -> None:
        """Say of which file the last part of `name` came."""
        spans = self._spans[name]
        spans[-1] = replace(spans[-1], filename=filename)

    def __contains__(self, name: str) -> bool:
        return name in self._spans

    def count(self, name: str) -> int:
        """How many parts have this name."""
        return len(self._spans.get(name, ()))

    def size(self, name: str) -> int:
        """Bytes of all parts of this name."""
        return sum(span.size for span in self._spans.get(name, ()))

    def read(self, name: str) -> tuple[Part, ...]:
        """The parts of this name, in their order."""
        spans = tuple(self._spans.get(name, ()))
        return PartsIndex({name: spans}).read(self._file)[name]

    def index(self) -> PartsIndex:
        """What a worker needs beside the descriptor."""
        return PartsIndex({name: tuple(spans) for name, spans in self._spans.items()})

    def descriptor(self) -> int:
        """A new descriptor of the memory; whoever asked for it closes it."""
        return os.dup(self._file)

    def close(self) -> None:
        """Let go of the memory; twice is once."""
        if self._file < 0:
            return
        os.close(self._file)
        self._file = -1
        if self._held is not None:
            self._held.give_back(self._written)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _anonymous_file() -> int:
    """Memory where the system has such files (Linux), else a temporary file without a name."""
    if hasattr(os, "memfd_create"):
        return os.memfd_create("boxlift-request", os.MFD_CLOEXEC)
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())
