"""A small application behind a real server, in a thread of its own."""

from __future__ import annotations

import asyncio
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import uvicorn
from starlette.types import ASGIApp, Receive, Scope, Send

from boxlift_service.guards.connections import Connections, protocol_class
from boxlift_service.settings import ServiceSettings


@dataclass
class Upload:
    """An application that reads the body, if it is called at all, and remembers who asked for what."""

    answer: bytes = b"done"
    asked: list[tuple[str, object]] = field(default_factory=list)
    body_bytes: int = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        assert scope["type"] == "http"
        self.asked.append((scope["path"], scope["state"].get("key")))
        more = True
        while more:
            message = await receive()
            if message["type"] == "http.disconnect":
                return
            self.body_bytes += len(message.get("body", b""))
            more = message.get("more_body", False)
        await send({"type": "http.response.start", "status": 200, "headers": [(b"x-request-id", b"1")]})
        await send({"type": "http.response.body", "body": self.answer})


@dataclass
class Served:
    """Where it listens; `connections` counts, `refused` says what was refused and why."""

    host: str
    port: int
    connections: Connections
    refused: list[str]

    @property
    def url(self) -> str:
        return f"http://{self.host}:{self.port}"

    def connect(self) -> socket.socket:
        """A connection of its own; nothing on it waits for more than 20 s."""
        return socket.create_connection((self.host, self.port), timeout=20)


@contextmanager
def served(app: ASGIApp, settings: ServiceSettings | None = None) -> Iterator[Served]:
    """`app` behind uvicorn with our protocol class, on a free port of this machine."""
    settings = settings or ServiceSettings()
    refused: list[str] = []
    connections = Connections(settings.max_connections, refused.append)
    listener = socket.create_server(("127.0.0.1", 0))
    host, port = listener.getsockname()
    config = uvicorn.Config(
        app,
        http=protocol_class(settings, connections),
        ws="none",
        lifespan="off",
        log_config=None,
        access_log=False,
        timeout_keep_alive=settings.keep_alive_s,
        timeout_graceful_shutdown=5,
    )
    server = uvicorn.Server(config)
    thread = threading.Thread(target=lambda: asyncio.run(server.serve(sockets=[listener])))
    thread.start()
    try:
        while not server.started:
            assert thread.is_alive(), "the server did not start"
            time.sleep(0.01)
        yield Served(host, port, connections, refused)
    finally:
        server.should_exit = True
        thread.join()


def read_to_end(connection: socket.socket) -> bytes:
    """All that comes until the other side closes. Raises TimeoutError where it does not."""
    received = b""
    while chunk := connection.recv(65536):
        received += chunk
    return received
