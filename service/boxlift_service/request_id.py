"""The outermost layer: a request has an id, and its failure is an answer."""

from __future__ import annotations

import logging
import re
import uuid

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from boxlift_service.problems import Kind, ProblemError

HEADER = "X-Request-ID"

_log = logging.getLogger("boxlift_service")
_USABLE_ID = re.compile(r"[A-Za-z0-9._:/+=-]{1,128}")


class RequestIdMiddleware:
    """Echoes the client's X-Request-ID (or makes one) and turns whatever escapes into a 500 problem."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        given = Headers(scope=scope).get(HEADER, "")
        request_id = given if _USABLE_ID.fullmatch(given) else uuid.uuid4().hex
        answered = False

        async def send_with_id(message: Message) -> None:
            nonlocal answered
            if message["type"] == "http.response.start":
                answered = True
                MutableHeaders(scope=message)[HEADER] = request_id
            await send(message)

        try:
            await self._app(scope, receive, send_with_id)
        except ClientDisconnect:
            _log.info("request %s: the client went away", request_id)
        # The last net: no fault of one request may end the server or show its insides.
        except Exception:
            _log.exception("request %s failed", request_id)
            if answered:
                raise
            problem = ProblemError(
                Kind.INTERNAL_ERROR,
                f"Request {request_id} failed for a reason that is ours.",
                "The service's log holds the cause under this id.",
            )
            await problem.response(scope["path"])(scope, receive, send_with_id)
