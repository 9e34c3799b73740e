"""POST /detect: images in, their 3D objects out."""

from __future__ import annotations

from time import perf_counter

from fastapi import APIRouter, Request
from starlette.responses import Response

from boxlift_service import documentation, timing
from boxlift_service.answers import DetectAnswer
from boxlift_service.detect_decoding import detect_fields
from boxlift_service.detection import Detection
from boxlift_service.detection_tasks import DetectTask
from boxlift_service.form import read_parts
from boxlift_service.negotiation import negotiate
from boxlift_service.problems import Kind
from boxlift_service.settings import ServiceSettings

JSON = "application/json"
TEXT = "text/plain"


def detect_routes(detection: Detection, settings: ServiceSettings) -> APIRouter:
    """POST /detect, computing in `detection` within the limits of `settings`."""
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
            **documentation.problem_responses(
                Kind.UNREADABLE_BODY,
                Kind.NOT_ACCEPTABLE,
                Kind.TOO_LARGE,
                Kind.UNSUPPORTED_MEDIA_TYPE,
                Kind.INVALID_FIELD,
                Kind.INTERNAL_ERROR,
                Kind.WORKER_DIED,
                Kind.MODEL_FAILED,
                Kind.NO_DETECTOR,
                Kind.NOT_READY,
            ),
        },
        openapi_extra={"requestBody": documentation.detect_request_body(settings.max_images)},
    )
    async def detect(request: Request) -> Response:
        """A prompt that cannot be used never fails its image: its entry says why it has no box."""
        times = timing.RequestTimes()
        accept = request.headers.get("accept")
        media_type = negotiate(accept, (JSON, TEXT))
        with times.stage("receive"):
            parts = await read_parts(request, fields)
        if len(parts["image"]) > 1:
            media_type = negotiate(accept, (JSON,))  # KITTI lines do not say of which image they are
        sent = perf_counter()
        found = await detection.run(DetectTask(parts, as_text=media_type == TEXT))
        # Whatever is not computing: waiting for those before, and the way there and back.
        times.seconds["queue"] = max(0.0, perf_counter() - sent - sum(found.seconds.values()))
        times.seconds.update(found.seconds)
        return Response(found.content, media_type=media_type, headers={timing.HEADER: times.header()})

    return routes
