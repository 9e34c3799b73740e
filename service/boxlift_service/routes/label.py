"""POST /label: a frame in, with prompts or without, its 3D labels out."""

from __future__ import annotations

from fastapi import APIRouter, Request
from starlette.responses import Response

from boxlift_service.answers import LabelAnswer
from boxlift_service.bodies.form import read_form
from boxlift_service.bodies.msgpack_frames import is_msgpack, read_msgpack
from boxlift_service.bodies.negotiation import negotiate
from boxlift_service.bodies.shared_parts import HeldBytes
from boxlift_service.documentation import documentation
from boxlift_service.labelling.decoding import label_fields
from boxlift_service.labelling.labelling import Labelling
from boxlift_service.labelling.tasks import AnswerFormat
from boxlift_service.settings import ServiceSettings
from boxlift_service.telemetry import timing
from boxlift_service.telemetry.metrics import Metrics
from boxlift_service.workers.deadline import Deadline, unless_gone

TEXT = AnswerFormat.TEXT.value


def label_routes(
    labelling: Labelling, settings: ServiceSettings, held: HeldBytes, metrics: Metrics
) -> APIRouter:
    """POST /label, by `labelling`; bodies are counted in `held`."""
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
            **documentation.problem_responses(*documentation.WORK_KINDS),
        },
        openapi_extra={
            "parameters": [documentation.DEADLINE_PARAMETER],
            "requestBody": documentation.label_request_body(),
        },
    )
    async def label(request: Request) -> Response:
        """A prompt that cannot be used never fails the frame: its entry says why it has no box."""
        times: timing.RequestTimes = request.state.times
        answer = AnswerFormat(
            negotiate(request.headers.get("accept"), (AnswerFormat.JSON.value, AnswerFormat.TEXT.value))
        )
        deadline = Deadline.of(request)
        labelling.labellers.require_room()
        with times.stage("receive"):
            if is_msgpack(request.headers.get("content-type", "")):
                parts = await read_msgpack(request.stream(), fields, held)
            else:
                parts = await read_form(request, fields, held)
        with parts:
            labelled = await unless_gone(request, labelling.label(parts, answer, times, deadline=deadline))
        metrics.count_results("/label", labelled.results)
        headers = {timing.HEADER: times.header()}
        return Response(labelled.content, media_type=answer.value, headers=headers)

    return routes
