"""The outermost layer: a request has an id, its failure is an answer, and what became of it is told."""

from __future__ import annotations

import logging
import re
import uuid
from collections.abc import Collection
from typing import TYPE_CHECKING

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from boxlift.errors import MissingExtraError
from boxlift_service.problems import Kind, ProblemError
from boxlift_service.telemetry import logs
from boxlift_service.telemetry.metrics import CLIENT_GONE, Metrics
from boxlift_service.telemetry.timing import RequestTimes

if TYPE_CHECKING:
    from opentelemetry.trace import Span

    from boxlift_service.telemetry.tracing import Tracing

REQUEST_ID_HEADER = "X-Request-ID"
OTHER = "other"

_METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})
# Asked every few seconds by machines: a line only where something is wrong.
_PROBES = frozenset({"/healthz", "/readyz", "/metrics"})
_MAX_LENGTH = 200
_USABLE_ID = re.compile(r"[A-Za-z0-9._:/+=-]{1,128}")

_log = logging.getLogger("boxlift_service.requests")


def start_tracing() -> Tracing:
    """Traces as the OTEL_* variables have them. Raises MissingExtraError without the extra `otel`."""
    try:
        from boxlift_service.telemetry.tracing import Tracing
    except ModuleNotFoundError as error:
        raise MissingExtraError(error.name or "opentelemetry-sdk", "otel") from None
    return Tracing()


class ObservationMiddleware:
    """Echoes X-Request-ID (or makes one), turns whatever escapes into a 500 problem, tells each request.

    Told is by metrics, one log line and, where `tracing` is given, a trace. `request.state.times` are the
    stages of the request, `request.state.request_id` its id; `request.state.key`, where an inner layer
    sets it, is whose key it came with. Whoever finds the client gone raises ClientDisconnect.
    """

    def __init__(
        self, app: ASGIApp, metrics: Metrics, paths: Collection[str], tracing: Tracing | None = None
    ) -> None:
        """`paths` are those that the service has, without /v1: any other is told as `other`."""
        self._app = app
        self._metrics = metrics
        self._paths = frozenset(paths)
        self._tracing = tracing

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request = _Request(scope, send)
        scope.setdefault("state", {}).update(times=request.times, request_id=request.id)
        about = {"request_id": request.id}
        if self._tracing is not None:
            request.span = self._tracing.begin(scope, request.method, request.times)
            about["trace_id"] = self._tracing.trace_id(request.span)
        # Left set: the server logs in this task, too.
        logs.of_request.set(about)
        try:
            await self._app(scope, receive, request.send)
            request.client_gone = request.status is not None and not request.answered
        except ClientDisconnect:
            request.client_gone = not request.answered
        # The last net: no fault of one request may end the server or show its insides.
        except Exception:
            _log.exception("the request failed")
            if request.status is not None:
                raise
            problem = ProblemError(
                Kind.INTERNAL_ERROR,
                f"Request {request.id} failed for a reason that is ours.",
                "The service's log holds the cause under this id.",
            )
            await problem.response(scope["path"])(scope, receive, request.send)
        finally:
            self._tell(request)

    def _tell(self, request: _Request) -> None:
        route, method = self._route(request), request.method
        status, seconds = request.final_status, request.seconds
        self._metrics.observe_request(route, method, status, seconds)
        self._metrics.observe_stages(route, request.times.seconds)
        if self._tracing is not None and request.span is not None:
            self._tracing.end(
                request.span, request.times, method=method, route=route, status=status, request_id=request.id
            )
        fields = {"method": method, "route": route, "status": status, "ms": round(1000 * seconds, 1)}
        shown = route
        if route == OTHER:
            fields["path"] = request.scope["path"][:_MAX_LENGTH]
            shown = f"{OTHER} {fields['path']!r}"
        if (key := request.scope["state"].get("key")) is not None:
            fields["key"] = key
            shown += f" (key {key})"
        level = logging.DEBUG if route in _PROBES and status < 400 else logging.INFO
        message = f"{method} {shown} {status} in {1000 * seconds:.1f} ms"
        _log.log(level, "%s", message, extra={"fields": fields})

    def _route(self, request: _Request) -> str:
        """The template of the route, or the path where an inner layer answered before the routes."""
        path = getattr(request.scope.get("route"), "path", None)
        if isinstance(path, str):
            return path.removeprefix("/v1")
        path = str(request.scope["path"]).removeprefix("/v1")
        return path if path in self._paths else OTHER


class _Request:
    """A request, and its answer as far as it has been sent."""

    def __init__(self, scope: Scope, send: Send) -> None:
        self.times = RequestTimes()
        self.scope = scope
        given = Headers(scope=scope).get(REQUEST_ID_HEADER, "")
        self.id = given if _USABLE_ID.fullmatch(given) else uuid.uuid4().hex
        self.method = scope["method"] if scope["method"] in _METHODS else OTHER
        self.span: Span | None = None
        self.status: int | None = None
        self.answered = False
        self.client_gone = False
        self._send = send
        self._last_byte_s: float | None = None

    async def send(self, message: Message) -> None:
        """What the application sends, with the id among its headers."""
        if message["type"] == "http.response.start":
            self.status = message["status"]
            MutableHeaders(scope=message)[REQUEST_ID_HEADER] = self.id
        await self._send(message)
        # The empty end of a lingering close comes long after the client has its answer.
        if message["type"] == "http.response.start" or message.get("body"):
            self._last_byte_s = self.times.since_start()
        if message["type"] == "http.response.body":
            self.answered = not message.get("more_body", False)

    @property
    def final_status(self) -> int:
        """What it counts as: an answer that broke off, or that never came, is no success."""
        if self.client_gone:
            return CLIENT_GONE
        if self.status is None or not self.answered:
            return Kind.INTERNAL_ERROR.status
        return self.status

    @property
    def seconds(self) -> float:
        """Until its answer had been sent, or until now."""
        return self.times.since_start() if self._last_byte_s is None else self._last_byte_s
