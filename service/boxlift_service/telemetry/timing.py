"""Stages of a request, measured and told in its answer (W3C Server Timing)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter, time_ns

from boxlift.stage_times import StageTimes

HEADER = "Server-Timing"


class RequestTimes(StageTimes):
    """Stage times of one request, from its headers on.

    Stages are timed by `stage`, or written to `seconds` in the order they ran.
    """

    def __init__(self) -> None:
        super().__init__()
        self._start_ns = time_ns()
        self._start = perf_counter()
        self._timed: dict[str, tuple[float, float]] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the body of a `with` under `name`."""
        start = self.since_start()
        with super().stage(name):
            yield
        self._timed[name] = (start, start + self.seconds[name])

    def since_start(self) -> float:
        """Seconds since the request began."""
        return perf_counter() - self._start

    def header(self) -> str:
        """The value of Server-Timing, milliseconds: `receive;dur=1.2, ..., total;dur=70.1`."""
        stages = {**self.seconds, "total": self.since_start()}
        return ", ".join(f"{name};dur={1000 * seconds:.3f}" for name, seconds in stages.items())

    def spans(self) -> Iterator[tuple[str, int, int]]:
        """Every stage with its begin and its end, nanoseconds since 1970.

        A stage of which only the seconds are known begins where the one before it ended.
        """
        end = 0.0
        for name, seconds in self.seconds.items():
            begin, end = self._timed.get(name, (end, end + seconds))
            yield name, self.clock_ns(begin), self.clock_ns(end)

    def clock_ns(self, since_start: float = 0.0) -> int:
        """Nanoseconds since 1970 of the moment that came `since_start` seconds after the request began."""
        return self._start_ns + round(1e9 * since_start)
