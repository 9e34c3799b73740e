"""Stages of a request, measured and told in its answer (W3C Server Timing)."""

from __future__ import annotations

from time import perf_counter

from boxlift.labeller import StageTimes

HEADER = "Server-Timing"


class RequestTimes(StageTimes):
    """Stage times of one request, from its first byte of headers on."""

    def __init__(self) -> None:
        super().__init__()
        self._start = perf_counter()

    def since_start(self) -> float:
        """Seconds since the request began."""
        return perf_counter() - self._start

    def header(self) -> str:
        """The value of Server-Timing, milliseconds: `receive;dur=1.2, ..., total;dur=70.1`."""
        stages = {**self.seconds, "total": self.since_start()}
        return ", ".join(f"{name};dur={1000 * seconds:.3f}" for name, seconds in stages.items())
