"""The ASGI application: routes, problems and the two layers around them."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from fastapi import FastAPI
from starlette.exceptions import HTTPException

import boxlift
from boxlift.errors import InputError
from boxlift.formats.size_priors import read_size_priors
from boxlift.settings import PRESETS
from boxlift_service.answer_examples import with_answer_examples
from boxlift_service.body_limit import BodyLimitMiddleware
from boxlift_service.detection import Detection
from boxlift_service.engine import Engine
from boxlift_service.problems import ProblemError, on_http_exception, on_input_error, on_problem
from boxlift_service.request_id import RequestIdMiddleware
from boxlift_service.routes.detect import detect_routes
from boxlift_service.routes.health import health_routes
from boxlift_service.routes.label import label_routes
from boxlift_service.routes.models import models_routes
from boxlift_service.settings import ServiceSettings


class _Application(FastAPI):
    def openapi(self) -> dict[str, Any]:
        return with_answer_examples(super().openapi())


def create_app(settings: ServiceSettings) -> FastAPI:
    """The service as an ASGI application; its warm-up begins when the server starts it.

    Raises OptionsError where the priors file cannot be used, ModelFileError where a model file that the
    settings name cannot be, MissingExtraError where it would need ONNX Runtime.
    """
    sizes = read_size_priors(settings.priors) if settings.priors else {}
    presets = {name: preset.with_sizes(sizes) for name, preset in PRESETS.items()}
    engine = Engine(settings)
    detection = Detection(settings)
    detection.check_given_models()

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        engine.start()
        detection.start()
        yield
        # Work in the engine may wait for detection.
        engine.stop()
        detection.stop()

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
    app.include_router(label_routes(engine, detection, settings, presets))
    app.include_router(detect_routes(detection, settings))
    app.include_router(health_routes(engine, detection))
    app.include_router(models_routes(detection, presets))
    app.add_exception_handler(ProblemError, on_problem)
    app.add_exception_handler(InputError, on_input_error)
    app.add_exception_handler(HTTPException, on_http_exception)
    # What is added last lies outermost.
    app.add_middleware(
        BodyLimitMiddleware, max_body_bytes=settings.max_body_bytes, linger_s=settings.linger_s
    )
    app.add_middleware(RequestIdMiddleware)
    return app
