"""POST /label: a frame with prompts in, its 3D labels out."""

from __future__ import annotations

from collections.abc import Mapping
from time import perf_counter

from fastapi import APIRouter, Request
from starlette.responses import Response

from boxlift.formats.details import details_of, kitti_text
from boxlift.labeller import Labeller
from boxlift.settings import LabellerSettings
from boxlift_service import documentation, timing
from boxlift_service.answers import LabelAnswer, label_answer_of
from boxlift_service.decoding import decode_label_request, label_fields
from boxlift_service.engine import Engine
from boxlift_service.form import Part, read_form
from boxlift_service.negotiation import negotiate
from boxlift_service.problems import Kind
from boxlift_service.routes.detect import no_detector
from boxlift_service.settings import ServiceSettings

JSON = "application/json"
TEXT = "text/plain"


def label_routes(
    engine: Engine, settings: ServiceSettings, presets: Mapping[str, LabellerSettings]
) -> APIRouter:
    """POST /label, computing in `engine` within the limits of `settings`, by one of `presets`."""
    routes = APIRouter(tags=["labels"])
    fields = label_fields(settings)

    @routes.post(
        "/label",
        summary="Lift the 2D prompts of one frame to 3D boxes",
        response_class=Response,
        responses={
            200: {
                "model": LabelAnswer,
                "description": "The labels: as JSON, or as KITTI result lines (only prompts with a box).",
                "headers": documentation.ANSWER_HEADERS,
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
                Kind.NO_DETECTOR,
            ),
        },
        openapi_extra={"requestBody": documentation.label_request_body()},
    )
    async def label(request: Request) -> Response:
        """A prompt that cannot be used never fails the frame: its entry says why it has no box."""
        times = timing.RequestTimes()
        media_type = negotiate(request.headers.get("accept"), (JSON, TEXT))
        with times.stage("receive"):
            parts = await read_form(request, fields)
        if "prompts" not in parts:
            raise no_detector("Send the field prompts.")
        queued = perf_counter()

        def work() -> bytes:
            times.seconds["queue"] = perf_counter() - queued
            return _label(parts, media_type, settings, presets, times)

        content = await engine.run(work)
        return Response(content, media_type=media_type, headers={timing.HEADER: times.header()})

    return routes


def _label(
    parts: dict[str, Part],
    media_type: str,
    limits: ServiceSettings,
    presets: Mapping[str, LabellerSettings],
    times: timing.RequestTimes,
) -> bytes:
    """The body of the answer."""
    with times.stage("decode"):
        request = decode_label_request(parts, limits, presets)
    labels = Labeller(request.settings).label(request.frame, times)
    with times.stage("encode"):
        if media_type == TEXT:
            return kitti_text(details_of(labels)).encode()
        return label_answer_of(request, labels).model_dump_json(by_alias=True).encode()
