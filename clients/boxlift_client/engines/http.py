"""boxlift services elsewhere, one or many: frames are loaded and labels written here, the services label.

All services take frames from one queue, each as it has room. One that is busy (429, 503 with Retry-After) is
asked again when it said; one that is gone gives its frames back and is asked again later, and must then still
label as the others do. Only when none has answered for a while does the run end; no frame fails for it.
"""

from __future__ import annotations

import asyncio
import queue
import threading
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from contextlib import AsyncExitStack, suppress
from dataclasses import dataclass, field
from time import perf_counter

from boxlift_client.async_client import AsyncClient
from boxlift_client.client import DEFAULT_TIMEOUT_S
from boxlift_client.engines import LabellerIdentity
from boxlift_client.errors import (
    NotAuthorizedError,
    RequestRefusedError,
    ServiceBusyError,
    ServiceError,
    ServiceProblemError,
    UnexpectedAnswerError,
)
from boxlift_client.http_exchange import jittered
from boxlift_client.job import FrameReport, FrameStore, LabelJob, report_of_failure

# Enough that a service never waits for a client that loads or writes.
REQUESTS_IN_FLIGHT = 4
# A run over a dataset has time: a service that is busy with others delays frames, and loses none.
PATIENCE_S = 3600.0
# With several services a frame does not wait as long for one of them.
_PATIENCE_AMONG_MANY_S = 2.0
# How long the run waits for any of its services; how often it asks one that is gone.
_GONE_S = 60.0
_SHORTEST_REST_S, _LONGEST_REST_S = 0.5, 10.0
_MOST_TRIES = 5
_REPORTS_WAITING = 1000


class HttpEngine:
    """The services at `urls`, `workers` requests in flight to each.

    gone_s: how long the run waits while no service answers.
    """

    def __init__(
        self, urls: str | Sequence[str], workers: int | None = None, *, gone_s: float = _GONE_S
    ) -> None:
        self._urls = [urls] if isinstance(urls, str) else list(dict.fromkeys(urls))
        self._workers = workers or REQUESTS_IN_FLIGHT
        self._gone_s = gone_s

    def identity(self, job: LabelJob) -> LabellerIdentity:
        """See Engine.identity: that of the first service that answers.

        Raises ServiceError where none does, or where it is not ready.
        """
        return asyncio.run(self._identity(job))

    def run(self, job: LabelJob, names: Sequence[str]) -> Iterator[FrameReport]:
        """See Engine.run. Raises ServiceError where no service is there, or not ready."""
        reports: queue.Queue[FrameReport | BaseException | None] = queue.Queue(_REPORTS_WAITING)
        loop = asyncio.new_event_loop()
        task = loop.create_task(self._run(job, names, reports))

        def work() -> None:
            end: BaseException | None = None
            try:
                loop.run_until_complete(task)
            except BaseException as error:
                end = error
                while isinstance(end, BaseExceptionGroup):  # the first task's is as good as any
                    end = end.exceptions[0]
            finally:
                loop.run_until_complete(loop.shutdown_default_executor())
                loop.close()
                reports.put(end)

        thread = threading.Thread(target=work, daemon=True)
        thread.start()
        try:
            while isinstance(report := reports.get(), FrameReport):
                yield report
            if report is not None:
                raise report
        finally:
            if thread.is_alive():
                loop.call_soon_threadsafe(task.cancel)
                while thread.is_alive():  # it may wait for room for a report
                    try:
                        reports.get(timeout=0.1)
                    except queue.Empty:
                        continue
            thread.join()

    async def _identity(self, job: LabelJob) -> LabellerIdentity:
        failed: ServiceError | None = None
        for url in self._urls:
            async with AsyncClient(url) as client:
                try:
                    await client.wait_until_ready()
                    return await identity_of(client, job)
                except ServiceError as error:
                    failed = failed or error
        assert failed is not None
        raise failed

    async def _run(
        self, job: LabelJob, names: Sequence[str], reports: queue.Queue[FrameReport | BaseException | None]
    ) -> None:
        patience_s = PATIENCE_S if len(self._urls) == 1 else _PATIENCE_AMONG_MANY_S
        timeout_s = job.frame_timeout_s or DEFAULT_TIMEOUT_S
        room = _Room(job, names, await self._identity(job), reports, self._gone_s)
        async with AsyncExitStack() as clients, asyncio.TaskGroup() as tasks:
            for url in self._urls:
                client = AsyncClient(url, patience_s=patience_s, timeout_s=timeout_s)
                service = _Service(await clients.enter_async_context(client))
                for _ in range(self._workers):
                    tasks.create_task(room.label_with(service))


def _not_now(error: ServiceError) -> bool:
    return isinstance(error, ServiceProblemError) and error.problem.status == 503


async def identity_of(client: AsyncClient, job: LabelJob) -> LabellerIdentity:
    """Who labels at a service. Raises ServiceError."""
    models = await client.models()
    detector = models.get("detector") or {}
    return LabellerIdentity(
        str(models.get("boxlift_version")), detector.get("digest") if job.detects else None
    )


@dataclass
class _Service:
    """A service, and whether it may be given frames. rest_s: until it is asked again after it was gone."""

    client: AsyncClient
    admitted: bool = False
    rest_s: float = _SHORTEST_REST_S
    lock: asyncio.Lock = field(default_factory=asyncio.Lock)


class _Room:
    """The frames to do, and the services that do them."""

    def __init__(
        self,
        job: LabelJob,
        names: Sequence[str],
        identity: LabellerIdentity,
        reports: queue.Queue[FrameReport | BaseException | None],
        gone_s: float,
    ) -> None:
        self._job = job
        self._names = iter(names)
        self._again: deque[str] = deque()
        self._identity = identity
        self._reports = reports
        self._gone_s = gone_s
        self._heard_s = perf_counter()
        self._in_flight = 0
        self._finished = asyncio.Event()
        self._tries: Counter[str] = Counter()
        self._store = FrameStore(job)

    async def label_with(self, service: _Service) -> None:
        """Give frames to a service, one after the other, until all are reported."""
        while not self._finished.is_set():
            if not await self._is_admitted(service):
                continue
            if self._has_more():
                await self._label_next(service)
            elif self._in_flight == 0:
                self._finished.set()
            else:  # one of those in flight may come back
                await self._rest(0.05)

    def _has_more(self) -> bool:
        if not self._again and (name := next(self._names, None)) is not None:
            self._again.append(name)
        return bool(self._again)

    async def _label_next(self, service: _Service) -> None:
        name = self._again.popleft()
        self._in_flight += 1
        try:
            if (report := await self._label(service, name)) is not None:
                await asyncio.to_thread(self._reports.put, report)
        finally:
            self._in_flight -= 1

    async def _rest(self, seconds: float) -> None:
        """Until the time is over, or all frames are reported."""
        with suppress(TimeoutError):
            await asyncio.wait_for(self._finished.wait(), seconds)

    async def _label(self, service: _Service, name: str) -> FrameReport | None:
        """The report of a frame; None where it is to be tried again."""
        start = perf_counter()
        try:
            loaded = await asyncio.to_thread(self._store.load, name)
            details = loaded.details
            if details is None:
                answer = await service.client.label(
                    loaded.given_frame, self._job.settings, detect=self._job.detects
                )
                details = answer.details
            self._heard_s = perf_counter()
            service.rest_s = _SHORTEST_REST_S
            return await asyncio.to_thread(self._store.finish, loaded, details, perf_counter() - start)
        except ServiceBusyError:
            self._heard_s = perf_counter()
            self._again.append(name)
            await self._rest(jittered(_SHORTEST_REST_S))
            return None
        except (NotAuthorizedError, UnexpectedAnswerError):
            raise
        except RequestRefusedError as error:
            return report_of_failure(name, error, perf_counter() - start)
        except ServiceError as error:
            # Its fault or the frame's: other tries will tell.
            service.admitted = False
            self._tries[name] += not _not_now(error)
            if self._tries[name] >= _MOST_TRIES and self._somebody_answers():
                return report_of_failure(name, error, perf_counter() - start)
            self._again.appendleft(name)
            return None
        except Exception as error:
            return report_of_failure(name, error, perf_counter() - start)

    def _somebody_answers(self) -> bool:
        return perf_counter() - self._heard_s < self._gone_s / 2

    async def _is_admitted(self, service: _Service) -> bool:
        """Whether a service is there, and labels as the first one did; after a rest where it is not."""
        async with service.lock:
            if service.admitted:
                return True
            try:
                await service.client.wait_until_ready(self._gone_s)
                identity = await identity_of(service.client, self._job)
            except (NotAuthorizedError, UnexpectedAnswerError):
                raise
            except ServiceError:
                if perf_counter() - self._heard_s > self._gone_s:
                    raise
                await self._rest(jittered(service.rest_s))
                service.rest_s = min(2 * service.rest_s, _LONGEST_REST_S)
                return False
            if identity != self._identity:
                raise UnexpectedAnswerError(
                    service.client.base_url,
                    f"it labels otherwise than the other services ({identity}, not {self._identity}). Give "
                    "all of them the same version and detector.",
                )
            self._heard_s = perf_counter()
            service.admitted = True
            return True
