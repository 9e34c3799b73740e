"""A client's end of an HTTP/1.1 connection that sends bytes made beforehand.

A load generator shares the machine with what it measures: here a request costs it a write and the search for
the end of the answer. And it needs what HTTP libraries hide: half a request, a reset, an answer that comes
before the request has been sent.
"""

from __future__ import annotations

import asyncio
import json
import socket
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast
from urllib.parse import urlsplit

_LONGEST_ANSWER = 2**26


class LostError(Exception):
    """The connection ended, or was never there, and no whole answer had come."""


@dataclass(frozen=True)
class Answer:
    """An answer as it came; names of headers in lower case."""

    status: int
    headers: Mapping[str, str]
    body: bytes

    @property
    def slug(self) -> str:
        """The kind of a problem, e.g. `worker-died`; empty for any other answer."""
        if self.headers.get("content-type") != "application/problem+json":
            return ""
        return str(json.loads(self.body).get("type", "")).rpartition(":")[2]

    @property
    def closes(self) -> bool:
        """Whether the connection ends with it."""
        return self.headers.get("connection", "").lower() == "close"


class Connection(asyncio.Protocol):
    """One connection; one request at a time. Made by `Connection.open`."""

    def __init__(self) -> None:
        self._received = bytearray()
        self._answer: asyncio.Future[Answer] | None = None
        self._end: LostError | None = None
        self.transport: asyncio.Transport

    @classmethod
    async def open(cls, url: str, receive_buffer: int | None = None) -> Connection:
        """Connect to the host and port of `url`. Raises LostError where nobody listens."""
        parts = urlsplit(url)
        end = socket.socket()
        end.setblocking(False)
        if receive_buffer is not None:
            end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        loop = asyncio.get_running_loop()
        try:
            await loop.sock_connect(end, (parts.hostname, parts.port))
            _, connection = await loop.create_connection(cls, sock=end)
        except OSError as error:
            end.close()
            raise LostError(f"not connected ({type(error).__name__})") from None
        return connection

    @property
    def reusable(self) -> bool:
        """Whether it is open, and all that was written has been sent."""
        return (
            self._end is None
            and not self.transport.is_closing()
            and self.transport.get_write_buffer_size() == 0
        )

    def send(self, data: bytes) -> None:
        """Write some of a request."""
        self.transport.write(data)

    async def ask(self, request: bytes, timeout_s: float) -> Answer:
        """Send a whole request. Raises LostError, TimeoutError."""
        self.send(request)
        return await self.answer(timeout_s)

    async def answer(self, timeout_s: float) -> Answer:
        """The next answer, whether or not its request has been sent to the end. Raises as `ask`."""
        self._answer = asyncio.get_running_loop().create_future()
        self._read_answer()
        if self._end is not None and not self._answer.done():
            raise self._end
        return await asyncio.wait_for(self._answer, timeout_s)

    def close(self) -> None:
        """End it as a client does that has all it wants."""
        self.transport.close()

    def reset(self) -> None:
        """End it with a RST, as the kernel of a client does that has crashed."""
        end = cast(socket.socket, self.transport.get_extra_info("socket"))
        end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self.transport.abort()

    # What asyncio calls.

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.Transport, transport)

    def data_received(self, data: bytes) -> None:
        self._received += data
        self._read_answer()

    def connection_lost(self, exc: Exception | None) -> None:
        self._end = LostError(f"reset: {exc}" if exc else "closed without an answer")
        if self._answer is not None and not self._answer.done():
            self._answer.set_exception(self._end)

    def _read_answer(self) -> None:
        """Hand over the answer if all of it is there."""
        if self._answer is None or self._answer.done():
            return
        head_end = self._received.find(b"\r\n\r\n")
        if head_end < 0:
            return
        status_line, *lines = self._received[:head_end].decode("latin-1").split("\r\n")
        headers = {
            name.strip().lower(): value.strip() for name, _, value in (x.partition(":") for x in lines)
        }
        length = int(headers.get("content-length", _LONGEST_ANSWER))
        body_end = head_end + 4 + length
        if len(self._received) >= body_end:
            body = bytes(self._received[head_end + 4 : body_end])
            del self._received[:body_end]
            self._answer.set_result(Answer(int(status_line.split()[1]), headers, body))


async def get(url: str, path: str, timeout_s: float = 10.0) -> Answer:
    """A GET on a connection of its own. Raises LostError, TimeoutError."""
    connection = await Connection.open(url)
    try:
        host = urlsplit(url).netloc
        request = f"GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n"
        return await connection.ask(request.encode(), timeout_s)
    finally:
        connection.close()
