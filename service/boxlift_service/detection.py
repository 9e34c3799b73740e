"""Where objects are found in images: ONNX Runtime in a process of its own, replaced when it ends.

torch and ONNX Runtime in one process take each other's threads; and whatever happens there to the one, the
other labels on.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from time import perf_counter
from typing import TypeVar

from boxlift.errors import InputError, ModelFileError
from boxlift_service.detection_models import (
    ModelInfo,
    Models,
    NoModelError,
    infos_of,
    open_models,
    require_given,
)
from boxlift_service.problems import Kind, ProblemError
from boxlift_service.settings import ServiceSettings
from boxlift_service.worker_process import WorkerDiedError, WorkerFaultError, WorkerProcess

T = TypeVar("T")

_log = logging.getLogger("boxlift_service")

# As many of the largest images as fit into a request take less on any machine; what takes longer hangs.
_DEADLINE_S = 120.0
_NOT_LOADED = "The models are not loaded yet."


class Detection:
    """Runs work in the process with the models, one after the other, first come first served.

    detector, monocular: what is told of the models; of those of the process before, while one is replaced.
    """

    def __init__(self, settings: ServiceSettings) -> None:
        self._settings = settings
        self._worker = WorkerProcess(open_models, (settings,), _DEADLINE_S)
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="boxlift-detection")
        self._not_ready: str | None = _NOT_LOADED
        self.detector = self.monocular = ModelInfo(missing=_NOT_LOADED)

    def check_given_models(self) -> None:
        """Load the models now where the settings name files.

        Raises ModelFileError for a file that cannot be used, MissingExtraError without ONNX Runtime.
        """
        if self._settings.model is None and self._settings.detector is None:
            return
        try:
            self._worker.start()
            self._worker.call(require_given)
        except WorkerDiedError as error:
            self._worker.stop()
            raise ModelFileError(
                "BOXLIFT_MODEL, BOXLIFT_DETECTOR",
                f"the process that loads them died: {error}",
                "Give others.",
            ) from None
        except BaseException:
            self._worker.stop()
            raise

    def start(self) -> None:
        """Begin to load the models."""
        self._executor.submit(self._open)

    def stop(self) -> None:
        """Finish the work that runs, drop what waits, end the process."""
        self._executor.shutdown(wait=True, cancel_futures=True)
        self._worker.stop()

    def require_ready(self) -> None:
        """Raises ProblemError (503) while the models are loaded, or where they cannot be."""
        if self._not_ready is not None:
            raise self._not_ready_problem(self._not_ready)

    async def run(self, work: Callable[[Models], T]) -> T:
        """What `work`, a picklable object, returns for the models, computed in their process.

        Raises what the work does, and ProblemError: the process ended (500), the model failed (500), there
        is none (503).
        """
        return await asyncio.wrap_future(self._submit(work))

    def call(self, work: Callable[[Models], T]) -> T:
        """As `run`, for threads that may wait."""
        return self._submit(work).result()

    def _submit(self, work: Callable[[Models], T]) -> Future[T]:
        return self._executor.submit(self._compute, work)

    def _compute(self, work: Callable[[Models], T]) -> T:
        self._open()
        if self._not_ready is not None:
            raise self._not_ready_problem(self._not_ready)
        try:
            result: T = self._worker.call(work)
            return result
        except NoModelError as error:
            remedy = "Install it, or set BOXLIFT_MODEL and BOXLIFT_DETECTOR to files of your own."
            raise ProblemError(Kind.NO_DETECTOR, str(error), remedy) from None
        except ModelFileError as error:
            _log.error("a model failed: %s", error)
            raise ProblemError(Kind.MODEL_FAILED, error.problem, error.remedy) from None
        except WorkerDiedError as error:
            _log.error("the process that finds objects has to be replaced: %s", error)
            raise ProblemError(
                Kind.WORKER_DIED,
                f"The process that finds objects was lost with this request: {error}",
                "It is being replaced: send the request again. If that ends alike, the request is the cause.",
            ) from None

    def _open(self) -> None:
        """Have a process that works, or a reason why there is none."""
        if self._not_ready is None and self._worker.lives:
            return
        start = perf_counter()
        self._not_ready = _NOT_LOADED
        try:
            if not self._worker.lives:
                self._worker.start()
            self.detector, self.monocular = self._worker.call(infos_of)
        except (WorkerDiedError, WorkerFaultError, InputError, OSError) as error:
            _log.error("the models cannot be loaded: %s", error)
            self._not_ready = f"The models cannot be loaded: {str(error).strip().splitlines()[-1]:.300}"
            return
        self._not_ready = None
        _log.info("models loaded in %.1f s", perf_counter() - start)
        self._worker.watch(self._replace)

    def _replace(self) -> None:
        """The process has ended: have another one before somebody asks."""
        with suppress(RuntimeError):  # the executor takes nothing more: the service stops
            self._executor.submit(self._open)

    def _not_ready_problem(self, reason: str) -> ProblemError:
        return ProblemError(
            Kind.NOT_READY, reason, "Try again in a few seconds.", headers={"Retry-After": "2"}
        )
