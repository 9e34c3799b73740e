"""Probes: is the process alive, and can it label and find objects."""

from __future__ import annotations

from fastapi import APIRouter

from boxlift_service import documentation
from boxlift_service.answers import StatusAnswer
from boxlift_service.detection import Detection
from boxlift_service.engine import Engine
from boxlift_service.problems import Kind


def health_routes(engine: Engine, detection: Detection) -> APIRouter:
    """GET /healthz and GET /readyz."""
    routes = APIRouter(tags=["state"])

    @routes.get("/healthz", summary="Whether the process is alive")
    async def healthz() -> StatusAnswer:
        """Answers as long as the event loop runs."""
        return StatusAnswer(status="alive")

    @routes.get(
        "/readyz",
        summary="Whether frames can be labelled and objects found",
        responses=documentation.problem_responses(Kind.NOT_READY),
    )
    async def readyz() -> StatusAnswer:
        """Answers 200 while a built-in frame has been labelled and the models are loaded, else 503.

        An installation without models is ready too: it labels.
        """
        engine.require_ready()
        detection.require_ready()
        return StatusAnswer(status="ready")

    return routes
