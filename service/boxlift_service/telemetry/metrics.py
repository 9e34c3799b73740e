"""What the service counts and measures, in the text format of Prometheus."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from prometheus_client import (
    CONTENT_TYPE_PLAIN_0_0_4,
    CollectorRegistry,
    Counter,
    Gauge,
    Histogram,
    ProcessCollector,
    disable_created_metrics,
    generate_latest,
)
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

import boxlift

CLIENT_GONE = 499
"""Status of a request whose client did not wait for the answer."""

WORKER_STATES = ("ready", "starting", "failed")

_REQUEST_BUCKETS_S = (
    *(0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.075),
    *(0.1, 0.15, 0.2, 0.3, 0.5, 0.75, 1.0, 1.5, 2.5, 5.0, 10.0, 30.0, 60.0, 120.0),
)
_STAGE_BUCKETS_S = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0)

# Series that begin with 0, so that the first occurrence is an increase.
_REFUSALS = ("too_busy",)
_HTTP_REFUSALS = ("connections", "headers", "held_bytes", "key", "origin", "rate", "unread")
_DROPS = ("client_gone", "deadline")
_RESTARTS = ("died", "silent", "late", "reload")

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class PoolState:
    """A pool of workers at one moment; `workers` counts them by state, `pids` are in the workers' order."""

    permits: float
    permits_taken: float
    queued: int
    running: int
    workers: Mapping[str, int]
    pids: tuple[int, ...]


class Metrics:
    """The series of one server process; its methods belong to one thread."""

    def __init__(self) -> None:
        # A second series for each, which says when it began, and nobody asks.
        disable_created_metrics()  # type: ignore[no-untyped-call]
        self._registry = registry = CollectorRegistry()
        self._requests = Counter(
            "boxlift_requests",
            "Requests answered; status 499: the client went away.",
            ("route", "method", "status"),
            registry=registry,
        )
        self._request_seconds = Histogram(
            "boxlift_request_seconds",
            "From the headers of a request to the end of its answer; refusals (4xx) are left out.",
            ("route",),
            registry=registry,
            buckets=_REQUEST_BUCKETS_S,
        )
        self._stage_seconds = Histogram(
            "boxlift_stage_seconds",
            "Stages of a request, as in Server-Timing.",
            ("route", "stage"),
            registry=registry,
            buckets=_STAGE_BUCKETS_S,
        )
        self._results = Counter(
            "boxlift_results", "Objects by the result of their fit.", ("route", "result"), registry=registry
        )
        self._refused = Counter(
            "boxlift_refused", "Requests refused to keep up.", ("pool", "reason"), registry=registry
        )
        self._dropped = Counter(
            "boxlift_dropped", "Accepted work that was given up.", ("pool", "reason"), registry=registry
        )
        self._restarts = Counter(
            "boxlift_worker_restarts", "Workers replaced.", ("pool", "reason"), registry=registry
        )
        build = Gauge("boxlift_build_info", "Always 1; says the version.", ("version",), registry=registry)
        build.labels(boxlift.__version__).set(1)
        _begin(self._refused, "http", _HTTP_REFUSALS)
        self._now = _Now()
        registry.register(self._now)
        ProcessCollector(registry=registry)

    def observe_request(self, route: str, method: str, status: int, seconds: float) -> None:
        """A request that has ended; `route` and `method` are of a small set, whatever clients send."""
        self._requests.labels(route, method, status).inc()
        # Refusals are quick, and many of them would hide how long the others take.
        if not 400 <= status < CLIENT_GONE:
            self._request_seconds.labels(route).observe(seconds)

    def observe_stages(self, route: str, seconds: Mapping[str, float]) -> None:
        """The stages of a request."""
        for stage, value in seconds.items():
            self._stage_seconds.labels(route, stage).observe(value)

    def count_results(self, route: str, results: Mapping[str, int]) -> None:
        """Objects by the names of their fit results."""
        for result, count in results.items():
            self._results.labels(route, result).inc(count)

    def count_refused(self, pool: str, reason: str) -> None:
        """A request that was not taken on; pool `http`: before it came to a pool."""
        self._refused.labels(pool, reason).inc()

    def count_dropped(self, pool: str, reason: str) -> None:
        """Work that was taken on and is not finished, since nobody waits for it."""
        self._dropped.labels(pool, reason).inc()

    def count_restart(self, pool: str, reason: str) -> None:
        """A worker that is replaced."""
        self._restarts.labels(pool, reason).inc()

    def watch_pool(self, pool: str, state: Callable[[], PoolState]) -> None:
        """Tell the state of a pool from now on; `state` is called by every scrape."""
        self._now.pools[pool] = state
        _begin(self._refused, pool, _REFUSALS)
        _begin(self._dropped, pool, _DROPS)
        _begin(self._restarts, pool, _RESTARTS)

    def watch(self, name: str, description: str, value: Callable[[], float]) -> None:
        """Tell a value under `name` from now on; `value` is called by every scrape."""
        self._now.values[name] = (description, value)

    def exposition(self) -> tuple[bytes, str]:
        """The answer to a scrape and its content type. What cannot be read is left out and logged."""
        return generate_latest(self._registry), CONTENT_TYPE_PLAIN_0_0_4


class _Now(Collector):
    """Gauges that are read when somebody asks."""

    def __init__(self) -> None:
        self.pools: dict[str, Callable[[], PoolState]] = {}
        self.values: dict[str, tuple[str, Callable[[], float]]] = {}

    def describe(self) -> Iterable[Metric]:
        """Nothing: what is watched is not known yet."""
        return ()

    def collect(self) -> Iterator[Metric]:
        """The gauges of the pools, then the others."""
        yield from self._pool_gauges()
        for name, (description, value) in self.values.items():
            try:
                gauge = GaugeMetricFamily(name, description, value=value())
            # A scrape tells what it can: it is most needed when something is broken.
            except Exception:
                _log.exception("%s cannot be read", name)
            else:
                yield gauge

    def _pool_gauges(self) -> Iterator[Metric]:
        permits = GaugeMetricFamily("boxlift_permits", "Work that a pool takes on.", labels=["pool"])
        taken = GaugeMetricFamily("boxlift_permits_taken", "Work taken on.", labels=["pool"])
        queued = GaugeMetricFamily("boxlift_queue_requests", "Requests that wait.", labels=["pool"])
        running = GaugeMetricFamily("boxlift_running_requests", "Requests computed now.", labels=["pool"])
        workers = GaugeMetricFamily("boxlift_workers", "Workers by state.", labels=["pool", "state"])
        resident = GaugeMetricFamily(
            "boxlift_worker_resident_bytes", "Resident set of a worker.", labels=["pool", "worker"]
        )
        for pool, state_of in self.pools.items():
            try:
                state = state_of()
            except Exception:
                _log.exception("the state of pool %s cannot be read", pool)
                continue
            permits.add_metric([pool], state.permits)
            taken.add_metric([pool], state.permits_taken)
            queued.add_metric([pool], state.queued)
            running.add_metric([pool], state.running)
            for name, count in {**dict.fromkeys(WORKER_STATES, 0), **state.workers}.items():
                workers.add_metric([pool, name], count)
            for number, pid in enumerate(state.pids):
                if (size := resident_bytes(pid)) is not None:
                    resident.add_metric([pool, str(number)], size)
        yield from (permits, taken, queued, running, workers, resident)


def _begin(counter: Counter, pool: str, reasons: Iterable[str]) -> None:
    """Have the series, with 0."""
    for reason in reasons:
        counter.labels(pool, reason)


def resident_bytes(pid: int) -> int | None:
    """Resident set of a process, None where it has ended or the system does not say."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_bytes().split()[1])
    except (OSError, IndexError, ValueError):
        return None
    return pages * os.sysconf("SC_PAGE_SIZE")
