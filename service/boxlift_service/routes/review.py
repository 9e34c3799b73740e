"""The review page at /, and what it asks for: label sets, their queue, frames, corrections, dropped frames.

These routes are the page's own and may change with it; they are not part of the documented interface.
"""

from __future__ import annotations

import asyncio
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

from fastapi import APIRouter, Request
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.responses import JSONResponse, Response

from boxlift.corrections.correction import Correction, CorrectionConflictError, Opinion, Verdict
from boxlift.errors import DatasetError
from boxlift.formats.details import FrameDetails
from boxlift.formats.image import encoded_jpeg
from boxlift.priors import SIZE_PRIORS
from boxlift_service.bodies.form import read_form
from boxlift_service.bodies.shared_parts import HeldBytes
from boxlift_service.guards.auth import is_loopback
from boxlift_service.labelling.decoding import label_fields
from boxlift_service.labelling.labelling import Labelling
from boxlift_service.labelling.tasks import AnswerFormat
from boxlift_service.problems import Kind, ProblemError
from boxlift_service.review.dropped import FOLDER, DroppedFrame
from boxlift_service.review.label_sets import LabelSets, OpenLabelSet, points_cam
from boxlift_service.review.presence import Presence
from boxlift_service.settings import ServiceSettings
from boxlift_service.telemetry.metrics import Metrics
from boxlift_service.workers.deadline import unless_gone

DEFAULT_FOLDER = "boxlift-review"

_MOST_ENTRIES = 1000
# A small label set comes whole with the first answer.
_QUEUE_WAIT_S = 0.5
_FILES = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/review/page.js": ("page.js", "text/javascript; charset=utf-8"),
    "/review/page.css": ("page.css", "text/css; charset=utf-8"),
    "/review/icon.svg": ("icon.svg", "image/svg+xml"),
}
_PAGE_HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' blob: data:; frame-ancestors 'none'; "
    "base-uri 'none'; form-action 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",
}

_Body = TypeVar("_Body", bound=BaseModel)


class _CorrectionBody(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    label_set: str
    frame: str
    object_index: int = Field(ge=0)
    based_on: int = Field(ge=0)
    opinion: Opinion
    author: str = Field("", max_length=200)
    request_id: str = Field(min_length=8, max_length=64)


class _HeartbeatBody(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    label_set: str
    frame: str
    session: str = Field(min_length=8, max_length=64)
    author: str = Field("", max_length=200)
    since: int = Field(ge=0)


def review_folder(settings: ServiceSettings) -> Path | None:
    """Where label sets to review are; None where there is to be no review page.

    Beyond loopback nobody's disk is written to unless they say where.
    """
    if settings.label_sets is not None:
        return settings.label_sets
    return Path(DEFAULT_FOLDER) if is_loopback(settings.host) else None


def review_routes(
    label_sets: LabelSets | None,
    labelling: Labelling,
    settings: ServiceSettings,
    held: HeldBytes,
    metrics: Metrics,
) -> APIRouter:
    """GET / and /review/...; without `label_sets` they say so. Dropped frames are labelled by `labelling`."""
    routes = APIRouter(include_in_schema=False)
    presence = Presence()
    dropping = asyncio.Lock()

    def sets() -> LabelSets:
        if label_sets is None:
            raise ProblemError(
                Kind.NOT_FOUND,
                "This service has no folder of label sets.",
                "Start it with `boxlift serve --label-sets DIR`, or BOXLIFT_LABEL_SETS=DIR.",
            )
        return label_sets

    def add_file(path: str) -> None:
        name, media_type = _FILES[path]
        content = (files("boxlift_service.review") / "static" / name).read_bytes()

        async def page_file() -> Response:
            return Response(content, media_type=media_type, headers=_PAGE_HEADERS)

        routes.add_api_route(path, page_file, methods=["GET"])

    for path in _FILES:
        add_file(path)

    @routes.get("/review/label-sets")
    async def list_label_sets(request: Request) -> JSONResponse:
        names = await asyncio.to_thread(sets().names)
        who = getattr(request.state, "key", None)
        return JSONResponse({"label_sets": names, "author": who, "classes": sorted(SIZE_PRIORS)})

    @routes.get("/review/queue")
    async def queue(request: Request) -> JSONResponse:
        def answer() -> dict[str, Any]:
            opened = _opened(sets(), request)
            done = frozenset(
                (each.frame, each.object_index)
                for each in opened.store.latest()
                if each.opinion.verdict is not Verdict.OPEN
            )
            return opened.queue.state(_QUEUE_WAIT_S).to_json(_MOST_ENTRIES, done)

        return JSONResponse(await asyncio.to_thread(answer))

    @routes.get("/review/frame")
    async def frame(request: Request) -> JSONResponse:
        def answer() -> dict[str, Any]:
            opened, name = _opened(sets(), request), _frame_name(request)
            details = opened.details(name)
            answer: dict[str, Any] = {
                "details": details.model_dump(mode="json", by_alias=True),
                "corrections": [each.model_dump(mode="json") for each in opened.store.latest(name)],
            }
            try:
                loaded = opened.load(name)
            except DatasetError as error:
                return {**answer, "missing": str(error)}
            return {
                **answer,
                "image_size": loaded.image_size_px,
                "image_P_cam": loaded.calibration.image_P_cam.tolist(),
                "has_image": loaded.image is not None,
                "points": len(loaded.points_velo),
            }

        return JSONResponse(await asyncio.to_thread(answer))

    @routes.get("/review/image")
    async def image(request: Request) -> Response:
        def answer() -> bytes:
            loaded = _opened(sets(), request).load(_frame_name(request))
            if loaded.image is None:
                raise ProblemError(
                    Kind.NOT_FOUND, f"The frame {loaded.name!r:.200} has no image.", "Look at its points."
                )
            return encoded_jpeg(loaded.image)

        return Response(await asyncio.to_thread(answer), media_type="image/jpeg")

    @routes.get("/review/points")
    async def points(request: Request) -> Response:
        def answer() -> bytes:
            return points_cam(_opened(sets(), request).load(_frame_name(request))).tobytes()

        return Response(await asyncio.to_thread(answer), media_type="application/octet-stream")

    @routes.get("/review/corrections")
    async def corrections(request: Request) -> JSONResponse:
        said = await asyncio.to_thread(lambda: _opened(sets(), request).store.history())
        return JSONResponse([each.model_dump(mode="json") for each in said])

    @routes.post("/review/corrections")
    async def correct(request: Request) -> JSONResponse:
        """201 says that the correction is on disk; 409 brings what somebody else said meanwhile."""
        body = await _body(request, _CorrectionBody)
        author = _author(request, body.author)

        def keep() -> Correction:
            opened = sets().open(body.label_set)
            if body.object_index not in {item.index for item in opened.details(body.frame).objects}:
                raise ProblemError(
                    Kind.INVALID_FIELD,
                    f"The frame {body.frame!r:.200} has no object {body.object_index}.",
                    "Give the index of one of its objects.",
                    field="object_index",
                )
            return opened.store.add(
                body.frame,
                body.object_index,
                body.opinion,
                based_on=body.based_on,
                author=author,
                request_id=body.request_id,
            )

        try:
            kept = await asyncio.to_thread(keep)
        except CorrectionConflictError as error:
            latest = None if error.latest is None else error.latest.model_dump(mode="json")
            raise ProblemError(
                Kind.CONFLICT,
                str(error),
                "Look at what they said, and say it again if you still think so.",
                field="based_on",
                more={"latest": latest},
            ) from None
        return JSONResponse(kept.model_dump(mode="json"), status_code=201)

    @routes.post("/review/heartbeat")
    async def heartbeat(request: Request) -> JSONResponse:
        """Who else is here, and what was said after `since`."""
        body = await _body(request, _HeartbeatBody)
        author = _author(request, body.author)
        said = await asyncio.to_thread(lambda: sets().open(body.label_set).store.latest(since=body.since))
        others = presence.seen(body.session, body.label_set, body.frame, author)
        return JSONResponse(
            {"others": others, "corrections": [each.model_dump(mode="json") for each in said]}
        )

    @routes.post("/review/frames")
    async def drop(request: Request) -> JSONResponse:
        """Label a dropped frame with the default settings, and keep both."""
        kept_in = sets()
        labelling.labellers.require_room()
        with await read_form(request, label_fields(settings), held) as parts:
            async with dropping:  # two frames of one name take turns
                folder = kept_in.root / FOLDER
                dropped = await asyncio.to_thread(DroppedFrame, folder, parts)
                if "name" not in parts:
                    parts.write(dropped.name.encode())
                    parts.end_part("name")
                labelled = await unless_gone(
                    request, labelling.label(parts, AnswerFormat.JSON, request.state.times)
                )
                metrics.count_results("/review/frames", labelled.results)
                details = FrameDetails.model_validate_json(labelled.content)
                name = kept_in.name_of(folder)
                await asyncio.to_thread(kept_in.changed, name, lambda: dropped.write(details))
        return JSONResponse({"label_set": name, "frame": dropped.name}, status_code=201)

    return routes


def _opened(label_sets: LabelSets, request: Request) -> OpenLabelSet:
    return label_sets.open(_query(request, "set"))


def _frame_name(request: Request) -> str:
    return _query(request, "frame")


def _query(request: Request, name: str) -> str:
    value = request.query_params.get(name)
    if not value:
        raise ProblemError(
            Kind.INVALID_FIELD, f"The query has no {name!r}.", f"Add ?{name}=NAME.", field=name
        )
    return value


def _author(request: Request, given: str) -> str:
    """Whose key it is, where keys are asked for; else the name that the page was told."""
    return getattr(request.state, "key", None) or given.strip() or "anonymous"


async def _body(request: Request, model: type[_Body]) -> _Body:
    try:
        return model.model_validate_json(await request.body())
    except ValidationError as error:
        first = error.errors()[0]
        raise ProblemError(
            Kind.INVALID_FIELD,
            f"{first['msg']}.",
            "Send the JSON object that the page sends.",
            field=".".join(map(str, first["loc"])) or "body",
        ) from None
