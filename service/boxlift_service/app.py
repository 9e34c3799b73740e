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
from boxlift_service import documentation
from boxlift_service.body_limit import BodyLimitMiddleware
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
        return documentation.with_label_answer_example(super().openapi())


def create_app(settings: ServiceSettings) -> FastAPI:
    """The service as an ASGI application; its warm-up begins when the server starts it.

    Raises OptionsError where the priors file cannot be used.
    """
    sizes = read_size_priors(settings.priors) if settings.priors else {}
    presets = {name: preset.with_sizes(sizes) for name, preset in PRESETS.items()}
    engine = Engine(settings)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        engine.start()
        yield
        engine.stop()

    app = _Application(
        title="boxlift",
        summary="3D boxes from 2D boxes and LiDAR",
        description="Boxes are in the rectified camera frame (x right, y down, z forward), metres and "
        "radians. Every error is an application/problem+json document (RFC 9457).",
        version=boxlift.__version__,
        lifespan=lifespan,
        redirect_slashes=False,
        # The pages of Swagger and ReDoc would load their code from elsewhere.
        docs_url=None,
        redoc_url=None,
    )
    app.include_router(label_routes(engine, settings, presets))
    app.include_router(detect_routes())
    app.include_router(health_routes(engine))
    app.include_router(models_routes(presets))
    app.add_exception_handler(ProblemError, on_problem)
    app.add_exception_handler(InputError, on_input_error)
    app.add_exception_handler(HTTPException, on_http_exception)
    # What is added last lies outermost.
    app.add_middleware(
        BodyLimitMiddleware, max_body_bytes=settings.max_body_bytes, linger_s=settings.linger_s
    )
    app.add_middleware(RequestIdMiddleware)
    return app
