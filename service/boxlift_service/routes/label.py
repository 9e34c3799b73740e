"""POST /label: a frame in, with prompts or without, its 3D labels out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from time import perf_counter

from fastapi import APIRouter, Request
from starlette.responses import Response

from boxlift.formats.details import details_of, kitti_text
from boxlift.labeller import Labeller
from boxlift.settings import LabellerSettings
from boxlift_service import documentation, timing
from boxlift_service.answers import LabelAnswer, label_answer_of
from boxlift_service.decoding import decode_label_request, label_fields
from boxlift_service.detection import Detection
from boxlift_service.detection_tasks import FindPromptsTask
from boxlift_service.engine import Engine
from boxlift_service.form import Part, read_form
from boxlift_service.negotiation import negotiate
from boxlift_service.problems import Kind
from boxlift_service.settings import ServiceSettings

JSON = "application/json"
TEXT = "text/plain"


def label_routes(
    engine: Engine,
    detection: Detection,
    settings: ServiceSettings,
    presets: Mapping[str, LabellerSettings],
) -> APIRouter:
    """POST /label, computing in `engine` within the limits of `settings`, by one of `presets`.

    Where no prompts come along, `detection` finds them.
    """
    routes = APIRouter(tags=["labels"])
    fields = label_fields(settings)

    @routes.post(
        "/label",
        summary="Lift the 2D objects of one frame, given or found, to 3D boxes",
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
                Kind.WORKER_DIED,
                Kind.MODEL_FAILED,
                Kind.NO_DETECTOR,
                Kind.NOT_READY,
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
        queued = perf_counter()

        def work() -> bytes:
            times.seconds["queue"] = perf_counter() - queued
            return _label(parts, media_type, settings, presets, detection, times)

        content = await engine.run(work)
        return Response(content, media_type=media_type, headers={timing.HEADER: times.header()})

    return routes


def _label(
    parts: dict[str, Part],
    media_type: str,
    limits: ServiceSettings,
    presets: Mapping[str, LabellerSettings],
    detection: Detection,
    times: timing.RequestTimes,
) -> bytes:
    """The body of the answer."""
    with times.stage("decode"):
        request = decode_label_request(parts, limits, presets)
    frame, model_digest = request.frame, None
    if "prompts" not in parts:
        with times.stage("detect"):
            min_score = request.settings.detection.min_score
            found = detection.call(FindPromptsTask(parts["image"].data, min_score))
        frame = replace(frame, prompts=found.prompts, instance_ids=found.instance_ids)
        model_digest = found.model_digest
    labels = Labeller(request.settings).label(frame, times)
    with times.stage("encode"):
        if media_type == TEXT:
            return kitti_text(details_of(labels)).encode()
        answer = label_answer_of(labels, request.settings, request.dropped_points, model_digest)
        return answer.model_dump_json(by_alias=True).encode()
