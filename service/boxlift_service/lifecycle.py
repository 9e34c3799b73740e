"""Whether the service takes on more work, or is about to end."""

from __future__ import annotations

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send


class Lifecycle:
    """draining: the service was told to end; it still answers, and asks to be left out.

    ending: its port is closed; what was accepted is finished.
    """

    def __init__(self) -> None:
        self.draining = False
        self.ending = False


class LeaveWhileDrainingMiddleware:
    """While the service drains, every answer ends its connection: a kept one would break in the end."""

    def __init__(self, app: ASGIApp, lifecycle: Lifecycle) -> None:
        self._app = app
        self._lifecycle = lifecycle

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def send_last(message: Message) -> None:
            if message["type"] == "http.response.start" and self._lifecycle.draining:
                MutableHeaders(scope=message)["Connection"] = "close"
            await send(message)

        await self._app(scope, receive, send_last)
