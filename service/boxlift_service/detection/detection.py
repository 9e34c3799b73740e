"""Where objects are found in images: ONNX Runtime in processes of its own, which are replaced when they end.

torch and ONNX Runtime in one process take each other's threads; and whatever happens there to the one, the
other labels on.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Mapping
from typing import Any

from boxlift.errors import BoxliftError, ModelFileError
from boxlift.settings import LabellerSettings
from boxlift_service.bodies.shared_parts import SharedParts
from boxlift_service.detection.models import (
    ModelInfo,
    Models,
    NoModelError,
    infos_of,
    open_models,
    require_given,
)
from boxlift_service.problems import Kind, ProblemError
from boxlift_service.settings import ServiceSettings
from boxlift_service.telemetry.metrics import Metrics
from boxlift_service.workers.deadline import Deadline
from boxlift_service.workers.permits import Permits
from boxlift_service.workers.place import Staff
from boxlift_service.workers.pool import WorkerPool
from boxlift_service.workers.process import WorkerDiedError, WorkerFaultError, WorkerProcess

_log = logging.getLogger("boxlift_service")

_NOT_LOADED = "The models are not loaded yet."


class Detection:
    """The workers that hold the models. A permit is an image.

    detector, monocular: what is told of the models, as the worker that opened last has them.
    """

    def __init__(
        self, settings: ServiceSettings, presets: Mapping[str, LabellerSettings], metrics: Metrics
    ) -> None:
        self._settings = settings
        self._presets = presets
        self._reloading = asyncio.Lock()
        self._next_reload: asyncio.Task[None] | None = None
        self.detector = self.monocular = ModelInfo(missing=_NOT_LOADED)
        self.pool = WorkerPool(
            Staff("detect", self._new_process, settings.silence_s, infos_of, self._learn),
            settings.detect_workers,
            Permits(settings.permits_per_worker * settings.detect_workers),
            metrics,
        )

    def check_given_models(self) -> None:
        """Load the models once where the settings name files.

        Raises ModelFileError for a file that cannot be used, MissingExtraError without ONNX Runtime.
        """
        if self._settings.model is None and self._settings.detector is None:
            return
        process = self._new_process()
        try:
            process.start()
            process.call(require_given)
        except WorkerDiedError as error:
            raise ModelFileError(
                "BOXLIFT_MODEL, BOXLIFT_DETECTOR",
                f"the process that loads them died: {error}",
                "Give others.",
            ) from None
        finally:
            process.stop()

    async def run(
        self,
        work: Callable[[Models, int], Any],
        parts: SharedParts,
        images: int = 1,
        *,
        wait: bool = False,
        deadline: Deadline | None = None,
    ) -> tuple[Any, float]:
        """What `work`, a picklable object, returns for the models and `parts`, and the seconds it waited.

        wait: for permits, instead of being refused. Raises what the work does, and ProblemError: too much
        work (429), the worker was lost or a model failed (500), there is none (503), the deadline passed
        (504).
        """
        try:
            async with self.pool.permitted(images, wait=wait, deadline=deadline):
                return await self.pool.run(work, parts.descriptor(), deadline)
        except NoModelError as error:
            remedy = "Install it, or set BOXLIFT_MODEL and BOXLIFT_DETECTOR to files of your own."
            raise ProblemError(Kind.NO_DETECTOR, str(error), remedy) from None
        except ModelFileError as error:
            _log.error("a model failed: %s", error)
            raise ProblemError(Kind.MODEL_FAILED, error.problem, error.remedy) from None

    async def reload(self) -> None:
        """Read the model files again, while the old models work on.

        Who asks while others wait for the same shares theirs. Raises ProblemError (503) where a file cannot
        be used: the old models stay.
        """
        if self._next_reload is None:
            self._next_reload = asyncio.create_task(self._reload())
            self._next_reload.add_done_callback(lambda task: task.cancelled() or task.exception())
        await asyncio.shield(self._next_reload)

    async def _reload(self) -> None:
        async with self._reloading:
            self._next_reload = None  # who asks from now on may mean newer files
            await self._renew()

    async def _renew(self) -> None:
        try:
            await self.pool.renew(require_given)
        except (BoxliftError, WorkerDiedError, WorkerFaultError, OSError) as error:
            _log.error("the models were not reloaded: %s", error)
            raise ProblemError(
                Kind.NOT_RELOADED,
                f"The models cannot be loaded ({str(error).strip():.300}); those before are used on.",
                "Mend the files that BOXLIFT_MODEL and BOXLIFT_DETECTOR name, and reload again.",
            ) from None
        _log.info("models reloaded: %s, %s", self.detector.digest[:12], self.monocular.digest[:12])

    def _new_process(self) -> WorkerProcess[Models]:
        return WorkerProcess(
            open_models,
            (self._settings, self._presets),
            self._settings.frame_limit_s,
            name="boxlift-detect",
        )

    def _learn(self, infos: tuple[ModelInfo, ModelInfo]) -> None:
        self.detector, self.monocular = infos
