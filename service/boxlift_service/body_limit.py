"""Bodies beyond the limit are refused while they come in; nothing of them is kept."""

from __future__ import annotations

import asyncio
from time import monotonic

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from boxlift_service.problems import Kind, ProblemError

# A client that sends nothing for this long has read its answer or is gone.
_IDLE_S = 2.0


class BodyLimitMiddleware:
    """Counts body bytes, first those announced and then those that come.

    An answer that is given before the body has been read ends with a lingering close: it is sent, then
    the rest of the body is read and dropped for a while. A connection that is closed with unread bytes
    in it is reset, and the client may lose the answer (RFC 9112, section 9.6).
    """

    def __init__(self, app: ASGIApp, max_body_bytes: int, linger_s: float) -> None:
        self._app = app
        self._max_body_bytes = max_body_bytes
        self._linger_s = linger_s

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        announced = int(headers.get("content-length", "0"))  # h11 admits digits only
        body_pending = announced > 0 or "transfer-encoding" in headers
        received = 0

        async def receive_limited() -> Message:
            nonlocal body_pending, received
            if announced > self._max_body_bytes:
                raise self._too_large(f"The body has {announced} bytes.")
            message = await receive()
            if message["type"] == "http.request":
                body_pending = message.get("more_body", False)
                received += len(message.get("body", b""))
                if received > self._max_body_bytes:
                    raise self._too_large(f"The body has more than {self._max_body_bytes} bytes.")
            return message

        async def send_and_linger(message: Message) -> None:
            if not body_pending:
                await send(message)
            elif message["type"] == "http.response.start":
                MutableHeaders(scope=message)["Connection"] = "close"
                await send(message)
            elif message.get("more_body", False):
                await send(message)
            else:
                await send({**message, "more_body": True})
                await self._drop_rest(receive)
                await send({"type": "http.response.body"})

        await self._app(scope, receive_limited, send_and_linger)

    def _too_large(self, problem: str) -> ProblemError:
        return ProblemError(Kind.TOO_LARGE, problem, f"Send at most {self._max_body_bytes} bytes.")

    async def _drop_rest(self, receive: Receive) -> None:
        deadline = monotonic() + self._linger_s
        while (left_s := deadline - monotonic()) > 0:
            try:
                message = await asyncio.wait_for(receive(), min(left_s, _IDLE_S))
            except TimeoutError:
                return
            if not message.get("more_body", False):
                return
