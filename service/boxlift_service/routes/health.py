"""Probes: is the process alive, and can it label and find objects."""

from __future__ import annotations

from collections.abc import Sequence

from fastapi import APIRouter

from boxlift_service.answers import StatusAnswer
from boxlift_service.documentation import documentation
from boxlift_service.lifecycle import Lifecycle
from boxlift_service.problems import Kind, ProblemError
from boxlift_service.workers.pool import WorkerPool


def health_routes(pools: Sequence[WorkerPool], lifecycle: Lifecycle) -> APIRouter:
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
        """Answers 200 while every worker has worked once and was heard from lately, else 503.

        So it is 503 while a worker is replaced, although the others work, and while the service drains. An
        installation without models is ready too: it labels.
        """
        if lifecycle.draining:
            raise ProblemError(
                Kind.NOT_READY,
                "The service is about to end.",
                "Ask another one.",
                headers={"Retry-After": "10"},
            )
        for pool in pools:
            pool.require_ready()
        return StatusAnswer(status="ready")

    return routes
