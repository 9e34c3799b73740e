"""Connections: how many may be open, and for how long one may keep the service waiting."""

from __future__ import annotations

import asyncio
import fcntl
import logging
import resource
import struct
import termios
from collections.abc import Callable
from http import HTTPStatus
from typing import ClassVar

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from boxlift_service.problems import Kind, ProblemError
from boxlift_service.settings import ServiceSettings

HEADERS_LIMIT_S = 15.0  # Longest time for headers; settings.receive_limit_s where that is less.

_REFUSED_LINGER_S = 1.0
_MOST_LINGERING = 100

_BACKLOG = 2048  # uvicorn's
_OTHER_FILES = 256

_log = logging.getLogger("boxlift_service")


class Connections:
    """How many connections are open, for the gauge, and the most that may be.

    `on_refused` is called with "connections" for one too many, "headers" where they do not come in in time,
    "unread" where an answer is not taken.
    """

    def __init__(self, limit: int, on_refused: Callable[[str], None] = lambda _: None) -> None:
        self.limit = limit
        self.on_refused = on_refused
        self.open = 0
        self.lingering = 0


def protocol_class(settings: ServiceSettings, connections: Connections) -> type[H11Protocol]:
    """What uvicorn takes as `http`: HTTP/1.1, watched as _Connection says."""

    class Connection(_Connection):
        state = connections
        headers_limit_s = min(HEADERS_LIMIT_S, settings.receive_limit_s)
        unread_limit_s = settings.receive_limit_s

    return Connection


def allow_open_files(settings: ServiceSettings) -> None:
    """Raise this process's limit of open files so that all connections fit, as far as the system lets it."""
    # Besides its socket, a request that comes in has its shared memory. A burst of connections is accepted
    # before the first of them is refused.
    wanted = 2 * settings.max_connections + _BACKLOG + _OTHER_FILES
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY and hard < wanted:
        _log.warning(
            "BOXLIFT_MAX_CONNECTIONS=%d may need %d open files, and the system allows %d (ulimit -Hn)",
            settings.max_connections,
            wanted,
            hard,
        )
        wanted = hard
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


class _Connection(H11Protocol):
    """A connection that is closed where its client keeps the service waiting.

    - Headers, also those of a further request on it, are in `headers_limit_s` after their first byte (after
      the connection was made, for the first request): 408.
    - An answer of which the client takes nothing for `unread_limit_s` is dropped.
    - Beyond the limit of connections, a new one gets 429 and is closed.
    """

    state: ClassVar[Connections]
    headers_limit_s: ClassVar[float]
    unread_limit_s: ClassVar[float]

    _headers_timer: asyncio.TimerHandle | None = None
    _unread_timer: asyncio.TimerHandle | None = None
    _unread_bytes = 0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        if self.state.open >= self.state.limit:
            self.state.on_refused("connections")
            refusal = _Refusal(self.state)
            transport.set_protocol(refusal)
            refusal.connection_made(transport)
            return
        self.state.open += 1
        super().connection_made(transport)
        self._watch_headers()

    def connection_lost(self, exc: Exception | None) -> None:
        self.state.open -= 1
        for timer in (self._headers_timer, self._unread_timer):
            if timer is not None:
                timer.cancel()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        self._watch_headers()

    def on_response_complete(self) -> None:
        super().on_response_complete()
        self._watch_unread()

    def pause_writing(self) -> None:
        super().pause_writing()
        self._watch_unread()

    def send_400_response(self, msg: str) -> None:
        if self.conn.our_state in (h11.IDLE, h11.SEND_RESPONSE):
            super().send_400_response(msg)
        else:
            # An answer is on its way already; a second one would be read as part of it.
            self.transport.close()
        self._watch_unread()

    def _watch_headers(self) -> None:
        asked = self.cycle is not None and not self.cycle.response_complete
        if asked or self.transport.is_closing():
            if self._headers_timer is not None:
                self._headers_timer.cancel()
                self._headers_timer = None
        elif self._headers_timer is None:
            self._headers_timer = self.loop.call_later(self.headers_limit_s, self._headers_are_late)

    def _headers_are_late(self) -> None:
        if self.transport.is_closing():
            return
        self.state.on_refused("headers")
        # A browser opens connections ahead and would take a 408 for the answer to what it sends later.
        if self.conn.our_state is h11.IDLE and self.conn.trailing_data[0]:
            problem = ProblemError(
                Kind.TIMEOUT,
                f"The headers were not complete after {self.headers_limit_s:g} s.",
                "Send the request in one go.",
            )
            self.transport.write(_whole_answer(problem))
        self.transport.close()
        self._watch_unread()

    def _watch_unread(self) -> None:
        """Look again in a while whether the client has taken something of what is to be sent."""
        if self._unread_timer is None and self.transport.get_write_buffer_size() > 0:
            self._unread_bytes = _unread_bytes(self.transport)
            self._unread_timer = self.loop.call_later(self.unread_limit_s, self._look_at_unread)

    def _look_at_unread(self) -> None:
        self._unread_timer = None
        left = self.transport.get_write_buffer_size()
        if left > 0 and _unread_bytes(self.transport) == self._unread_bytes:
            self.state.on_refused("unread")
            self.transport.abort()
        else:
            self._watch_unread()


class _Refusal(asyncio.Protocol):
    """Answers a connection beyond the limit, and drops what it sends until it goes or a second has passed.

    Closed at once, with bytes of the request unread, it would be reset and might lose the answer.
    """

    def __init__(self, connections: Connections) -> None:
        self._connections = connections
        self._timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        if self._connections.lingering == _MOST_LINGERING:
            transport.abort()
            return
        self._connections.lingering += 1
        problem = ProblemError(
            Kind.TOO_BUSY,
            f"{self._connections.limit} connections are open, the most that there may be.",
            "Try again in 1 s, and send several requests over one connection.",
            headers={"Retry-After": "1"},
        )
        transport.write(_whole_answer(problem))
        transport.write_eof()
        self._timer = asyncio.get_running_loop().call_later(_REFUSED_LINGER_S, transport.abort)

    def connection_lost(self, _: Exception | None) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._connections.lingering -= 1


def _whole_answer(problem: ProblemError) -> bytes:
    """The bytes of an answer to no request in particular, after which the connection closes."""
    response = problem.response("/")
    status = HTTPStatus(response.status_code)
    lines = [f"HTTP/1.1 {status.value} {status.phrase}".encode(), b"connection: close"]
    lines += [name + b": " + value for name, value in response.raw_headers]
    return b"\r\n".join(lines) + b"\r\n\r\n" + bytes(response.body)


def _unread_bytes(transport: asyncio.Transport) -> int:
    """Bytes that the client has not taken yet: those held here, and those that the system holds."""
    in_system = 0
    if (socket := transport.get_extra_info("socket")) is not None and socket.fileno() >= 0:
        (in_system,) = struct.unpack("i", fcntl.ioctl(socket.fileno(), termios.TIOCOUTQ, b"\0" * 4))
    return transport.get_write_buffer_size() + int(in_system)
