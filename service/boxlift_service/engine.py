"""Where computing happens: a few threads of its own, so that the event loop never waits for it."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from time import perf_counter
from typing import TypeVar

from boxlift_service.problems import Kind, ProblemError
from boxlift_service.settings import ServiceSettings
from boxlift_service.warm_up import warm_up

T = TypeVar("T")

_log = logging.getLogger("boxlift_service")


class Engine:
    """Runs work in worker threads, first come first served, once a warm-up has shown that it can.

    Waiting work has no bound yet; a queue with permits belongs here and nowhere else.
    """

    def __init__(self, settings: ServiceSettings) -> None:
        self._threads = settings.label_threads
        self._executor = ThreadPoolExecutor(settings.label_workers, thread_name_prefix="boxlift-worker")
        self._warm_up: Future[str | None] | None = None

    def start(self) -> None:
        """Begin the warm-up: it loads the libraries and labels a frame."""
        self._warm_up = self._executor.submit(self._warm_up_once)

    def stop(self) -> None:
        """Finish the work that runs and drop what waits."""
        self._executor.shutdown(wait=True, cancel_futures=True)

    def require_ready(self) -> None:
        """Raises ProblemError (503) until the warm-up has ended well."""
        if self._warm_up is None or not self._warm_up.done():
            raise ProblemError(
                Kind.NOT_READY,
                "The warm-up has not ended yet.",
                "Try again in a second.",
                headers={"Retry-After": "1"},
            )
        if (failure := self._warm_up.result()) is not None:
            raise ProblemError(Kind.NOT_READY, failure, "Mend the installation and start the service again.")

    async def run(self, work: Callable[[], T]) -> T:
        """What `work` returns or raises, computed in a worker. Raises ProblemError (503) if none can work."""
        if self._warm_up is not None and not self._warm_up.done():
            await asyncio.wait([asyncio.wrap_future(self._warm_up)])
        self.require_ready()
        return await asyncio.get_running_loop().run_in_executor(self._executor, self._compute, work)

    def _compute(self, work: Callable[[], T]) -> T:
        import torch

        # The number of OpenMP threads belongs to the calling thread, so every worker sets it.
        torch.set_num_threads(self._threads)
        return work()

    def _warm_up_once(self) -> str | None:
        """None, or why no frame can be labelled."""
        start = perf_counter()
        try:
            self._compute(warm_up)
        # Whatever is wrong with the installation, probes shall read it and the process shall live.
        except Exception as error:
            _log.exception("the warm-up failed")
            return f"The warm-up failed ({type(error).__name__}: {error!s:.300})."
        _log.info("ready: warmed up in %.1f s", perf_counter() - start)
        return None
