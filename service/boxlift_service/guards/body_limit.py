"""Bodies that are too large or too slow are refused while they come in; nothing of them is kept."""

from __future__ import annotations

import asyncio
from collections.abc import Collection
from time import monotonic

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from boxlift_service.problems import Kind, ProblemError
from boxlift_service.settings import ServiceSettings

# A client that sends nothing for this long has read its answer or is gone.
_IDLE_S = 2.0


class BodyLimitMiddleware:
    """Counts body bytes, first those announced and then those that come, and the time that they take.

    streamed: paths whose body is a stream of any length; a pause in it is limited all the same.

    An answer that is given before the body has been read ends with a lingering close: it is sent, then
    the rest of the body is read and dropped for a while. A connection that is closed with unread bytes
    in it is reset, and the client may lose the answer (RFC 9112, section 9.6).
    """

    def __init__(self, app: ASGIApp, settings: ServiceSettings, streamed: Collection[str] = ()) -> None:
        self._app = app
        self._settings = settings
        self._streamed = streamed

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        announced = int(headers.get("content-length", "0"))  # h11 admits digits only
        body_pending = announced > 0 or "transfer-encoding" in headers
        received = 0
        is_stream = scope["path"] in self._streamed
        limits = self._settings
        end = monotonic() + limits.receive_limit_s

        async def receive_limited() -> Message:
            nonlocal body_pending, received
            if not body_pending:  # what comes now is that the client leaves
                return await receive()
            if announced > limits.max_body_bytes and not is_stream:
                raise self._too_large(f"The body has {announced} bytes.")
            left_s = limits.receive_idle_s if is_stream else min(limits.receive_idle_s, end - monotonic())
            try:
                message = await asyncio.wait_for(receive(), max(0.0, left_s))
            except TimeoutError:
                raise self._too_slow(received) from None
            if message["type"] == "http.request":
                body_pending = message.get("more_body", False)
                received += len(message.get("body", b""))
                if received > limits.max_body_bytes and not is_stream:
                    raise self._too_large(f"The body has more than {limits.max_body_bytes} bytes.")
            return message

        async def send_and_linger(message: Message) -> None:
            if not body_pending or is_stream:
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
        most = self._settings.max_body_bytes
        return ProblemError(Kind.TOO_LARGE, problem, f"Send at most {most} bytes.")

    def _too_slow(self, received: int) -> ProblemError:
        limits = self._settings
        return ProblemError(
            Kind.TIMEOUT,
            f"The body stopped after {received} bytes.",
            f"Send without pauses of {limits.receive_idle_s:g} s, all within {limits.receive_limit_s:g} s.",
        )

    async def _drop_rest(self, receive: Receive) -> None:
        deadline = monotonic() + self._settings.linger_s
        while (left_s := deadline - monotonic()) > 0:
            try:
                message = await asyncio.wait_for(receive(), min(left_s, _IDLE_S))
            except TimeoutError:
                return
            if not message.get("more_body", False):
                return
