"""A boxlift service elsewhere: threads here load, send and write, the service labels."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait

from boxlift_client.client import Client
from boxlift_client.job import FrameReport, FrameWorker, LabelJob

# Enough that the service never waits for a client that loads or writes.
REQUESTS_IN_FLIGHT = 4


class HttpEngine:
    """Requests to the service at `url`, `workers` of them in flight."""

    def __init__(self, url: str, workers: int | None = None) -> None:
        self._url = url
        self._workers = workers or REQUESTS_IN_FLIGHT

    def run(self, job: LabelJob, names: Sequence[str]) -> Iterator[FrameReport]:
        """See Engine.run. Raises ServiceError where the service is not there or not ready."""
        with Client(self._url) as client:
            client.wait_until_ready()
            worker = FrameWorker(
                job, lambda frame: client.label(frame, job.settings, detect=job.detects).details
            )
            yield from in_threads(worker.label_one, names, self._workers)


def in_threads(
    work: Callable[[str], FrameReport], names: Sequence[str], workers: int
) -> Iterator[FrameReport]:
    """What `work` says of every name, as it finishes, by that many threads."""
    waiting = deque(names)
    in_flight: set[Future[FrameReport]] = set()
    pool = ThreadPoolExecutor(workers)
    try:
        while waiting or in_flight:
            while waiting and len(in_flight) < 2 * workers:
                in_flight.add(pool.submit(work, waiting.popleft()))
            done, in_flight = wait(in_flight, return_when=FIRST_COMPLETED)
            yield from (future.result() for future in done)
    finally:
        pool.shutdown(cancel_futures=True)
