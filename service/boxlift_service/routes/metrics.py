"""GET /metrics: what the service counts, for Prometheus."""

from __future__ import annotations

from fastapi import APIRouter
from starlette.responses import Response

from boxlift_service.telemetry.metrics import Metrics


def metrics_routes(metrics: Metrics) -> APIRouter:
    """GET /metrics, which tells `metrics`."""
    routes = APIRouter(tags=["state"])

    @routes.get(
        "/metrics",
        summary="Requests, stages, queues and workers in numbers, in the text format of Prometheus",
        response_class=Response,
        responses={
            200: {
                "description": "Every series with its help text.",
                "content": {
                    "text/plain": {
                        "schema": {"type": "string"},
                        "example": 'boxlift_requests_total{method="POST",route="/label",status="200"} 12.0\n',
                    }
                },
            }
        },
    )
    async def exposition() -> Response:
        """Names begin with boxlift_, or process_ for the server process itself."""
        content, content_type = metrics.exposition()
        return Response(content, headers={"Content-Type": content_type})

    return routes
