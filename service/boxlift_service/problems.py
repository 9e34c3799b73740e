"""Errors as RFC 9457 problem documents: one shape for every answer that is not a success."""

from __future__ import annotations

import json
from collections.abc import Mapping
from enum import Enum
from http import HTTPStatus
from typing import Any

from pydantic import BaseModel, ConfigDict, Field
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response

from boxlift.errors import InputError

MEDIA_TYPE = "application/problem+json"


class Kind(Enum):
    """The kinds of problems: slug of the type, status and title."""

    UNREADABLE_BODY = ("unreadable-body", 400, "The request body cannot be read")
    NOT_FOUND = ("not-found", 404, "There is no such resource")
    METHOD_NOT_ALLOWED = ("method-not-allowed", 405, "The resource does not support this method")
    UNAUTHORIZED = ("unauthorized", 401, "The request needs a valid API key")
    FORBIDDEN_ORIGIN = ("forbidden-origin", 403, "Pages of this origin may not call")
    NOT_ACCEPTABLE = ("not-acceptable", 406, "No answer has a media type that the client accepts")
    CONFLICT = ("conflict", 409, "Somebody else was faster")
    TIMEOUT = ("timeout", 408, "The request did not come in in time")
    TOO_LARGE = ("too-large", 413, "The request is too large")
    UNSUPPORTED_MEDIA_TYPE = ("unsupported-media-type", 415, "The request body has the wrong media type")
    INVALID_FIELD = ("invalid-field", 422, "A field of the request is missing, unknown or invalid")
    FETCH_REFUSED = ("fetch-refused", 422, "The service does not fetch from this URL")
    FETCH_FAILED = ("fetch-failed", 422, "The URL could not be fetched")
    TOO_BUSY = ("too-busy", 429, "The service has as much work as it takes on")
    RATE_LIMITED = ("rate-limited", 429, "This API key has used up its requests")
    INTERNAL_ERROR = ("internal-error", 500, "The service failed")
    WORKER_DIED = ("worker-died", 500, "The process that computed the answer ended")
    MODEL_FAILED = ("model-failed", 500, "The model failed on this input")
    NO_DETECTOR = ("no-detector", 503, "No detector is installed")
    NOT_RELOADED = ("not-reloaded", 503, "The models could not be reloaded")
    NOT_READY = ("not-ready", 503, "The service is not ready")
    DEADLINE_EXCEEDED = ("deadline-exceeded", 504, "The time that the client gave has passed")

    def __init__(self, slug: str, status: int, title: str) -> None:
        self.uri = f"urn:boxlift:problem:{slug}"
        self.status = status
        self.title = title


class ProblemDetails(BaseModel):
    """An error, as RFC 9457 defines it, with what is wrong and what to do as members of their own."""

    model_config = ConfigDict(frozen=True)

    type: str = Field(description="URI of the kind of problem.")
    title: str = Field(description="The kind of problem in words; the same for every occurrence.")
    status: int = Field(description="HTTP status code.")
    detail: str = Field(description="What happened this time, and what to do about it.")
    instance: str = Field(description="Path of the request.")
    field: str | None = Field(default=None, description="Field at fault, e.g. points or prompts[2].box.")
    problem: str | None = Field(default=None, description="What is wrong with which value.")
    remedy: str | None = Field(default=None, description="What to do about it.")


class ProblemError(Exception):
    """Raised anywhere while a request is handled; becomes its answer."""

    def __init__(
        self,
        kind: Kind,
        problem: str,
        remedy: str,
        *,
        field: str | None = None,
        headers: Mapping[str, str] | None = None,
        more: Mapping[str, Any] | None = None,
    ) -> None:
        """`more`: further members of the document, plain JSON."""
        super().__init__(kind, problem, remedy, field)
        self.more = dict(more or {})
        self.kind = kind
        self.problem = problem
        self.remedy = remedy
        self.field = field
        self.headers = dict(headers or {})

    def details(self, path: str) -> ProblemDetails:
        """What the request of `path` is told."""
        return ProblemDetails(
            type=self.kind.uri,
            title=self.kind.title,
            status=self.kind.status,
            detail=f"{self.problem} {self.remedy}",
            instance=path,
            field=self.field,
            problem=self.problem,
            remedy=self.remedy,
        )

    def response(self, path: str) -> Response:
        """The answer to the request of `path`."""
        return _response(self.details(path), self.headers, self.more)


async def on_problem(request: Request, error: Exception) -> Response:
    """Answer a ProblemError."""
    assert isinstance(error, ProblemError)
    return error.response(request.url.path)


def problem_of(error: InputError) -> ProblemError:
    """An InputError of the craft: some field is at fault."""
    return ProblemError(Kind.INVALID_FIELD, error.problem, error.remedy, field=error.field)


async def on_input_error(request: Request, error: Exception) -> Response:
    """Answer an InputError."""
    assert isinstance(error, InputError)
    return problem_of(error).response(request.url.path)


async def on_http_exception(request: Request, error: Exception) -> Response:
    """Answer what the framework refuses: unknown paths and methods above all."""
    assert isinstance(error, HTTPException)
    path, headers = request.url.path, error.headers
    if error.status_code == HTTPStatus.NOT_FOUND:
        problem = f"There is nothing at {path!r:.200}."
        return ProblemError(Kind.NOT_FOUND, problem, "GET /openapi.json lists what there is.").response(path)
    if error.status_code == HTTPStatus.METHOD_NOT_ALLOWED:
        allowed = (headers or {}).get("Allow", "")
        return ProblemError(
            Kind.METHOD_NOT_ALLOWED,
            f"{path!r:.200} does not support {request.method[:20]!r}.",
            f"Use {allowed}.",
            headers=headers,
        ).response(path)
    title = HTTPStatus(error.status_code).phrase
    details = ProblemDetails(
        type="about:blank", title=title, status=error.status_code, detail=str(error.detail), instance=path
    )
    return _response(details, headers or {})


def _response(
    details: ProblemDetails, headers: Mapping[str, str], more: Mapping[str, Any] | None = None
) -> Response:
    # Escaped to ASCII: what a client sent and the problem quotes need not be valid Unicode.
    content = json.dumps({**(more or {}), **details.model_dump(exclude_none=True)}, allow_nan=False)
    return Response(content, status_code=details.status, headers=dict(headers), media_type=MEDIA_TYPE)
