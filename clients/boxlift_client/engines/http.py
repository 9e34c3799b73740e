"""A boxlift service elsewhere: threads here load, send and write, the service labels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from boxlift_client.client import Client
from boxlift_client.in_threads import in_threads
from boxlift_client.job import FrameReport, FrameWorker, LabelJob

# Enough that the service never waits for a client that loads or writes.
REQUESTS_IN_FLIGHT = 4
# A run over a dataset has time: a service that is busy with others delays frames, and loses none.
PATIENCE_S = 3600.0


class HttpEngine:
    """Requests to the service at `url`, `workers` of them in flight."""

    def __init__(self, url: str, workers: int | None = None) -> None:
        self._url = url
        self._workers = workers or REQUESTS_IN_FLIGHT

    def run(self, job: LabelJob, names: Sequence[str]) -> Iterator[FrameReport]:
        """See Engine.run. Raises ServiceError where the service is not there or not ready."""
        with Client(self._url, patience_s=PATIENCE_S) as client:
            client.wait_until_ready()
            worker = FrameWorker(
                job, lambda frame: client.label(frame, job.settings, detect=job.detects).details
            )
            yield from in_threads(worker.label_one, names, self._workers)
