"""POST /detect: images in, their 3D objects out."""

from __future__ import annotations

from fastapi import APIRouter, Request
from starlette.responses import Response

from boxlift_service.answers import DetectAnswer
from boxlift_service.bodies.form import read_form
from boxlift_service.bodies.negotiation import negotiate
from boxlift_service.bodies.shared_parts import HeldBytes
from boxlift_service.detection.decoding import detect_fields
from boxlift_service.detection.detection import Detection
from boxlift_service.detection.tasks import DetectedImages, DetectTask
from boxlift_service.documentation import documentation
from boxlift_service.settings import ServiceSettings
from boxlift_service.telemetry import timing
from boxlift_service.telemetry.metrics import Metrics
from boxlift_service.workers.deadline import Deadline, unless_gone

JSON = "application/json"
TEXT = "text/plain"


def detect_routes(
    detection: Detection, settings: ServiceSettings, held: HeldBytes, metrics: Metrics
) -> APIRouter:
    """POST /detect, by `detection`; bodies are counted in `held`."""
    routes = APIRouter(tags=["labels"])
    fields = detect_fields(settings)

    @routes.post(
        "/detect",
        summary="Find the objects of one or several images and their 3D boxes, without LiDAR",
        response_class=Response,
        responses={
            200: {
                "model": DetectAnswer,
                "description": "The objects: as JSON, or, of one image, as KITTI result lines.",
                "headers": documentation.DETECT_ANSWER_HEADERS,
                "content": {
                    TEXT: {"schema": {"type": "string"}, "example": documentation.LABEL_TEXT_EXAMPLE},
                },
            },
            **documentation.problem_responses(*documentation.WORK_KINDS),
        },
        openapi_extra={
            "parameters": [documentation.DEADLINE_PARAMETER],
            "requestBody": documentation.detect_request_body(settings.max_images),
        },
    )
    async def detect(request: Request) -> Response:
        """A prompt that cannot be used never fails its image: its entry says why it has no box."""
        times: timing.RequestTimes = request.state.times
        accept = request.headers.get("accept")
        media_type = negotiate(accept, (JSON, TEXT))
        deadline = Deadline.of(request)
        detection.pool.require_room()
        with times.stage("receive"):
            parts = await read_form(request, fields, held)
        with parts:
            images = parts.count("image")
            if images > 1:
                media_type = negotiate(accept, (JSON,))  # KITTI lines do not say of which image they are
            task = DetectTask(parts.index(), as_text=media_type == TEXT)
            found: DetectedImages
            found, waited_s = await unless_gone(
                request, detection.run(task, parts, images, deadline=deadline)
            )
        times.seconds["queue"] = waited_s
        times.seconds.update(found.seconds)
        metrics.count_results("/detect", found.results)
        headers = {timing.HEADER: times.header()}
        return Response(found.content, media_type=media_type, headers=headers)

    return routes
