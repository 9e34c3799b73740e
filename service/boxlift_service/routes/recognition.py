"""POST /pointCloud/recognition: the interface of a model of Xtreme1, so that its users label inside it."""

from __future__ import annotations

import asyncio
from collections import Counter
from typing import Any

from fastapi import APIRouter, Request
from starlette.responses import Response

from boxlift.errors import InputError
from boxlift.formats.json_text import parse_json
from boxlift_service.bodies.shared_parts import HeldBytes
from boxlift_service.documentation import documentation
from boxlift_service.labelling.labelling import Labelling
from boxlift_service.problems import Kind, ProblemError
from boxlift_service.recognition.answers import REQUEST_BODY, RecognitionAnswer
from boxlift_service.recognition.fetching import Fetcher
from boxlift_service.recognition.recognition import Recognition
from boxlift_service.settings import ServiceSettings
from boxlift_service.telemetry import timing
from boxlift_service.telemetry.metrics import Metrics
from boxlift_service.workers.deadline import Deadline, unless_gone

PATH = "/pointCloud/recognition"
JSON = "application/json"

_LARGEST_BODY_BYTES = 2**18


def recognition_routes(
    labelling: Labelling, settings: ServiceSettings, held: HeldBytes, metrics: Metrics
) -> APIRouter:
    """POST /pointCloud/recognition, by `labelling`; what is labelled is counted in `held`.

    Raises OptionsError where settings.fetch_from holds what is no URL prefix.
    """
    routes = APIRouter(tags=["labels"])
    recognition = Recognition(labelling, Fetcher(settings), settings, held)

    @routes.post(
        PATH,
        summary="Label sweeps by URL, in the terms of the annotation tool Xtreme1",
        response_class=Response,
        responses={
            200: {
                "model": RecognitionAnswer,
                "description": "What became of each of the data: its boxes, or why there are none.",
                "headers": documentation.ANSWER_HEADERS,
            },
            **documentation.problem_responses(
                Kind.UNREADABLE_BODY,
                Kind.TIMEOUT,
                Kind.TOO_LARGE,
                Kind.UNSUPPORTED_MEDIA_TYPE,
                Kind.INVALID_FIELD,
                Kind.INTERNAL_ERROR,
            ),
        },
        openapi_extra={"requestBody": REQUEST_BODY},
    )
    async def recognise(request: Request) -> Response:
        """One of the data that cannot be fetched or labelled never fails the others.

        Xtreme1 takes any other status than 200 for a service that is away, asks three times more and tells
        its user nothing; so work is waited for, and what goes wrong is told beside each id.
        """
        times: timing.RequestTimes = request.state.times
        deadline = Deadline.of(request)
        with times.stage("receive"):
            datas = _datas_of(await _read_json(request), settings.max_images)
        results: Counter[str] = Counter()

        async def recognise_all() -> RecognitionAnswer:
            found = (recognition.recognise(data, times, results, deadline) for data in datas)
            return RecognitionAnswer(data=tuple(await asyncio.gather(*found)))

        answer = await unless_gone(request, recognise_all())
        metrics.count_results(PATH, results)
        return Response(answer.model_dump_json(), media_type=JSON, headers={timing.HEADER: times.header()})

    return routes


async def _read_json(request: Request) -> Any:
    """Raises ProblemError: another media type (415), too large (413), no JSON (400)."""
    given = request.headers.get("content-type", "")
    if given.partition(";")[0].strip().lower() != JSON:
        raise ProblemError(
            Kind.UNSUPPORTED_MEDIA_TYPE,
            f"The Content-Type is {given!r:.80}." if given else "There is no Content-Type.",
            f"Send {JSON}.",
            headers={"Accept-Post": JSON},
        )
    body = bytearray()
    async for chunk in request.stream():
        body += chunk
        if len(body) > _LARGEST_BODY_BYTES:
            raise ProblemError(
                Kind.TOO_LARGE,
                f"The body has more than {_LARGEST_BODY_BYTES} bytes.",
                "Send fewer data at a time: files go by URL.",
            )
    try:
        return parse_json(bytes(body), "body", InputError)
    except InputError as error:
        raise ProblemError(Kind.UNREADABLE_BODY, f"In the body {error.problem}", error.remedy) from None


def _datas_of(body: Any, most: int) -> list[Any]:
    """Raises ProblemError (422)."""
    datas = body.get("datas") if isinstance(body, dict) else None
    if not isinstance(datas, list) or len(datas) > most:
        given = f"there are {len(datas)}" if isinstance(datas, list) else f"it is {datas!r:.60}"
        remedy = f"Give a list of at most {most} objects with id, pointCloudUrl, imageUrls, cameraConfigUrl."
        raise ProblemError(Kind.INVALID_FIELD, f"Of the data {given}.", remedy, field="datas")
    return datas
