"""The ASGI application: routes, problems and the layers around them."""

from __future__ import annotations

import multiprocessing
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from typing import Any

from fastapi import FastAPI
from starlette.exceptions import HTTPException
from starlette.routing import Route

import boxlift
from boxlift.errors import InputError
from boxlift.formats.size_priors import read_size_priors
from boxlift.settings import PRESETS, LabellerSettings
from boxlift_service.answers import API_VERSION
from boxlift_service.batch import BatchService
from boxlift_service.bodies.shared_parts import HeldBytes
from boxlift_service.detection.detection import Detection
from boxlift_service.documentation import documentation
from boxlift_service.documentation.answer_examples import with_answer_examples
from boxlift_service.guards.api_keys import ApiKeys
from boxlift_service.guards.auth import AuthMiddleware, check_exposure
from boxlift_service.guards.body_limit import BodyLimitMiddleware
from boxlift_service.guards.origins import add_origin_layers
from boxlift_service.labelling.labelling import Labelling
from boxlift_service.labelling.worker import LabelWorker, open_label_worker
from boxlift_service.lifecycle import LeaveWhileDrainingMiddleware, Lifecycle
from boxlift_service.problems import ProblemError, on_http_exception, on_input_error, on_problem
from boxlift_service.review.label_sets import LabelSets
from boxlift_service.routes.detect import detect_routes
from boxlift_service.routes.health import health_routes
from boxlift_service.routes.label import label_routes
from boxlift_service.routes.label_batch import label_batch_routes
from boxlift_service.routes.metrics import metrics_routes
from boxlift_service.routes.models import models_routes
from boxlift_service.routes.recognition import recognition_routes
from boxlift_service.routes.review import review_folder, review_routes
from boxlift_service.settings import ServiceSettings
from boxlift_service.telemetry.metrics import Metrics
from boxlift_service.telemetry.observation import ObservationMiddleware, start_tracing
from boxlift_service.workers.permits import Permits
from boxlift_service.workers.place import Staff
from boxlift_service.workers.pool import WorkerPool
from boxlift_service.workers.process import WorkerProcess


class _Application(FastAPI):
    asks_for_keys = False

    def openapi(self) -> dict[str, Any]:
        document = with_answer_examples(super().openapi())
        return documentation.with_keys(document) if self.asks_for_keys else document


def create_app(
    settings: ServiceSettings, metrics: Metrics | None = None, lifecycle: Lifecycle | None = None
) -> FastAPI:
    """The service as an ASGI application; its workers begin to open when the server starts it.

    Raises OptionsError where the priors or the keys cannot be used, or others could reach it without keys;
    ModelFileError where a model file that the settings name cannot be; MissingExtraError where it would need
    ONNX Runtime.
    """
    check_exposure(settings)
    keys = ApiKeys(settings.api_keys) if settings.api_keys else None
    metrics, lifecycle = metrics or Metrics(), lifecycle or Lifecycle()
    tracing = start_tracing() if settings.tracing else None
    sizes = read_size_priors(settings.priors) if settings.priors else {}
    presets = {name: preset.with_sizes(sizes) for name, preset in PRESETS.items()}

    def on_refused(reason: str) -> None:
        metrics.count_refused("http", reason)

    held = HeldBytes(settings.max_held_bytes, lambda: on_refused("held_bytes"))
    detection = Detection(settings, presets, metrics)
    detection.check_given_models()
    labellers = _label_pool(settings, presets, metrics)
    labelling = Labelling(labellers, detection)
    reviewed = review_folder(settings)
    label_sets = None if reviewed is None else LabelSets(reviewed, settings.corrections)
    metrics.watch("boxlift_held_bytes", "Bytes of request bodies that are held.", lambda: held.taken)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        labellers.start()
        detection.pool.start()
        yield
        await labellers.stop()
        await detection.pool.stop()
        if label_sets is not None:
            label_sets.close()
        if tracing is not None:
            tracing.shutdown()

    app = _Application(
        title="boxlift",
        summary="3D boxes from 2D boxes and LiDAR, or from images alone",
        description="Boxes are in the rectified camera frame (x right, y down, z forward), metres and "
        "radians. Every error is an application/problem+json document (RFC 9457).",
        version=boxlift.__version__,
        lifespan=lifespan,
        redirect_slashes=False,
        # The pages of Swagger and ReDoc would load their code from elsewhere.
        docs_url=None,
        redoc_url=None,
    )
    app.state.reload = detection.reload  # for SIGHUP
    resources = (
        label_routes(labelling, settings, held, metrics),
        detect_routes(detection, settings, held, metrics),
        label_batch_routes(BatchService(labelling, settings, held, metrics, lifecycle)),
        recognition_routes(labelling, settings, held, metrics),
        health_routes((labellers, detection.pool), lifecycle),
        models_routes(detection, presets),
        metrics_routes(metrics),
        review_routes(label_sets, labelling, settings, held, metrics),
    )
    for routes in resources:
        app.include_router(routes)
        app.include_router(routes, prefix=f"/v{API_VERSION}", include_in_schema=False)
    app.add_exception_handler(ProblemError, on_problem)
    app.add_exception_handler(InputError, on_input_error)
    app.add_exception_handler(HTTPException, on_http_exception)

    # What is added last lies outermost.
    if keys is not None:
        app.asks_for_keys = True
        app.add_middleware(AuthMiddleware, keys=keys, settings=settings, on_refused=on_refused)
    add_origin_layers(app, settings, on_refused)
    streamed = {f"{version}/label:batch" for version in ("", f"/v{API_VERSION}")}
    app.add_middleware(LeaveWhileDrainingMiddleware, lifecycle=lifecycle)
    app.add_middleware(BodyLimitMiddleware, settings=settings, streamed=streamed)
    routed = [route for routes in resources for route in routes.routes]
    paths = {"/openapi.json", *(route.path for route in routed if isinstance(route, Route))}
    app.add_middleware(ObservationMiddleware, metrics=metrics, paths=paths, tracing=tracing)
    return app


def _label_pool(
    settings: ServiceSettings, presets: Mapping[str, LabellerSettings], metrics: Metrics
) -> WorkerPool:
    """The workers that label. A permit is a million objects x points."""
    multiprocessing.get_context("forkserver").set_forkserver_preload(["boxlift_service.labelling.libraries"])

    def new_process() -> WorkerProcess[LabelWorker]:
        return WorkerProcess(
            open_label_worker,
            (settings, presets),
            settings.frame_limit_s,
            method="forkserver",
            name="boxlift-label",
        )

    permits = Permits(settings.permits_per_worker * settings.label_workers)
    staff = Staff("label", new_process, settings.silence_s)
    return WorkerPool(staff, settings.label_workers, permits, metrics)
