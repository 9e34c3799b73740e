"""POST /detect: images in, their 3D objects out, once a detector is there."""

from __future__ import annotations

from fastapi import APIRouter
from starlette.responses import Response

from boxlift_service import documentation
from boxlift_service.problems import Kind, ProblemError


def no_detector(remedy: str) -> ProblemError:
    """The problem of a request that needs a detector."""
    return ProblemError(Kind.NO_DETECTOR, "no detector is installed.", remedy)


def detect_routes() -> APIRouter:
    """POST /detect."""
    routes = APIRouter(tags=["labels"])

    @routes.post(
        "/detect",
        summary="Find objects in images (not available yet)",
        response_class=Response,
        responses=documentation.problem_responses(Kind.NO_DETECTOR),
    )
    async def detect() -> Response:
        """Answers 503: this version of the service has no detector."""
        raise no_detector("Label with prompts: POST /label.")

    return routes
