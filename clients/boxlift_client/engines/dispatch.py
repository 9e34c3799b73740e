"""Frames to workers, whatever the workers are: one frame each at a time, and none of them trusted.

A worker that dies costs its frame another try in another worker; a frame that has taken several workers
down has failed. A frame that takes too long has failed too, and its worker is ended; long before, when it is
only slow, a stand-in starts, so that the others' pace stays.
"""

from __future__ import annotations

import statistics
from collections import Counter, deque
from collections.abc import Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from time import monotonic
from typing import Generic, Protocol, TypeVar

from boxlift.errors import BoxliftError, MissingExtraError
from boxlift_client.errors import WorkersCannotStartError
from boxlift_client.job import FrameReport, Outcome

Worker = TypeVar("Worker", bound=Hashable)

_MOST_DEATHS = 3
_MOST_FAILED_STARTS = 3
# Of the median frame's time: from when a frame is slow, and from when it hangs where no limit was given. A
# frame with a hundred objects takes about ten times the median, and a busy machine stretches it.
_SLOW, _HANGS = 10.0, 50.0
_SHORTEST_SLOW_S, _SHORTEST_HANGS_S = 1.0, 10.0
# Before any frame has told how long they take; the first one of a worker warms it up.
_FIRST_SLOW_S, _FIRST_HANGS_S = 5.0, 60.0
_DURATIONS_KEPT = 101
_DIED = (
    f"{_MOST_DEATHS} worker processes died while they labelled this frame (a crash in native code, or killed "
    "for lack of memory). Look at its points and image, or leave it out with --frames."
)
_HUNG = "It took longer than {limit:g} s, and its worker was ended. Give it longer with --frame-timeout."


@dataclass(frozen=True)
class Ready(Generic[Worker]):
    """A worker can take frames, or says why it never will."""

    worker: Worker
    problem: BoxliftError | str | None = None


@dataclass(frozen=True)
class Done(Generic[Worker]):
    """A worker has reported on its frame."""

    worker: Worker
    report: FrameReport


@dataclass(frozen=True)
class Died(Generic[Worker]):
    """A worker has ended, whatever it was doing."""

    worker: Worker


class Crew(Protocol[Worker]):
    """Workers of one kind."""

    def start(self) -> Worker:
        """Begin to start a worker; a Ready or Died tells how that ends."""

    def give(self, worker: Worker, name: str) -> None:
        """Hand a frame to a worker that is ready and has none."""

    def wait(self, timeout_s: float) -> Sequence[Ready[Worker] | Done[Worker] | Died[Worker]]:
        """What has happened, at least one event where the time suffices."""

    def end(self, worker: Worker) -> None:
        """End a worker at once; no event comes of it any more."""


def dispatch(
    crew: Crew[Worker], names: Iterable[str], workers: int, limit_s: float | None
) -> Iterator[FrameReport]:
    """One report per frame, as they finish, by `workers` workers of the crew, all of which are then ended.

    limit_s: how long a frame may take; None: fifty times the median, at least 10 s. Raises BoxliftError where
    no worker can start.
    """
    room = _Room(crew, names, workers, limit_s)
    try:
        yield from room.reports()
    finally:
        room.close()


class _Room(Generic[Worker]):
    """Who is there, and what each is doing."""

    def __init__(self, crew: Crew[Worker], names: Iterable[str], workers: int, limit_s: float | None) -> None:
        self._crew = crew
        self._names = iter(names)
        self._again: deque[str] = deque()
        self._workers = workers
        self._limit_s = limit_s
        self._starting: set[Worker] = set()
        self._idle: list[Worker] = []
        self._busy: dict[Worker, tuple[str, float]] = {}
        self._slow: set[Worker] = set()
        self._deaths: Counter[str] = Counter()
        self._failed_starts = 0
        self._durations_s: deque[float] = deque(maxlen=_DURATIONS_KEPT)

    def reports(self) -> Iterator[FrameReport]:
        """See dispatch."""
        while self._has_more() or self._busy:
            self._staff()
            self._hand_out()
            for event in self._crew.wait(self._seconds_to_next_deadline()):
                if isinstance(event, Ready):
                    self._welcome(event)
                elif isinstance(event, Done):
                    yield self._take(event)
                else:
                    yield from self._mourn(event.worker)
            yield from self._watch()

    def close(self) -> None:
        """End all workers."""
        for worker in [*self._starting, *self._idle, *self._busy]:
            self._crew.end(worker)

    def _has_more(self) -> bool:
        if not self._again and (name := next(self._names, None)) is not None:
            self._again.append(name)
        return bool(self._again)

    def _staff(self) -> None:
        """As many workers as asked for, the slow ones not counted; of those no more than as many again."""
        there = len(self._starting) + len(self._idle) + len(self._busy) - len(self._slow)
        while self._has_more() and there < self._workers and len(self._slow) <= self._workers:
            self._starting.add(self._crew.start())
            there += 1

    def _hand_out(self) -> None:
        while self._idle and self._has_more():
            worker, name = self._idle.pop(), self._again.popleft()
            self._busy[worker] = (name, monotonic())
            self._crew.give(worker, name)

    def _welcome(self, event: Ready[Worker]) -> None:
        self._starting.discard(event.worker)
        self._failed_starts = 0
        self._idle.append(event.worker)
        if isinstance(event.problem, BoxliftError) and not isinstance(event.problem, MissingExtraError):
            raise event.problem
        if event.problem is not None:
            raise WorkersCannotStartError(f"The workers cannot start: {event.problem}")

    def _take(self, event: Done[Worker]) -> FrameReport:
        self._busy.pop(event.worker)
        self._durations_s.append(event.report.seconds)
        if event.worker in self._slow:
            self._slow.discard(event.worker)
            if len(self._starting) + len(self._idle) + len(self._busy) >= self._workers:
                self._crew.end(event.worker)  # its stand-in has its place
                return event.report
        self._idle.append(event.worker)
        return event.report

    def _mourn(self, worker: Worker) -> Iterator[FrameReport]:
        self._slow.discard(worker)
        if worker in self._starting:
            self._starting.discard(worker)
            self._failed_starts += 1
            if self._failed_starts >= _MOST_FAILED_STARTS:
                raise WorkersCannotStartError(
                    "The workers cannot start: they end as soon as they start. Out of memory? A script that "
                    "labels needs `if __name__ == '__main__':` around its calls."
                )
        elif worker in self._idle:
            self._idle.remove(worker)
        elif worker in self._busy:
            name, since = self._busy.pop(worker)
            self._deaths[name] += 1
            if self._deaths[name] < _MOST_DEATHS:
                self._again.appendleft(name)
            else:
                yield FrameReport(name, Outcome.FAILED, _DIED, seconds=monotonic() - since)

    def _watch(self) -> Iterator[FrameReport]:
        """End workers whose frame hangs, and count those that are slow out."""
        now, (slow_s, limit_s) = monotonic(), self._limits_s()
        for worker, (name, since) in list(self._busy.items()):
            if now - since >= limit_s:
                self._crew.end(worker)
                self._busy.pop(worker)
                self._slow.discard(worker)
                sentence = _HUNG.format(limit=round(limit_s, 1))
                yield FrameReport(name, Outcome.FAILED, sentence, seconds=now - since)
            elif now - since >= slow_s:
                self._slow.add(worker)

    def _limits_s(self) -> tuple[float, float]:
        """From when a frame is slow, and from when it has failed."""
        if not self._durations_s:
            return _FIRST_SLOW_S, self._limit_s or _FIRST_HANGS_S
        median = statistics.median(self._durations_s)
        slow_s = max(_SLOW * median, _SHORTEST_SLOW_S)
        return slow_s, self._limit_s or max(_HANGS * median, _SHORTEST_HANGS_S)

    def _seconds_to_next_deadline(self) -> float:
        slow_s, limit_s = self._limits_s()
        now = monotonic()
        left = [
            since + (limit_s if worker in self._slow else min(slow_s, limit_s)) - now
            for worker, (_, since) in self._busy.items()
        ]
        return max(0.0, min([*left, 1.0]))
