from __future__ import annotations

import contextlib
import json
import logging
import socket
import subprocess
import sys
import time
from collections.abc import Callable

import httpx
import pytest
from starlette.types import Receive, Scope, Send

from boxlift_service.settings import ServiceSettings
from service.served import Served, Upload, read_to_end, served

HURRIED = ServiceSettings(receive_limit_s=0.4, keep_alive_s=60)
GET = b"GET /x HTTP/1.1\r\nHost: localhost\r\n\r\n"


def eventually(condition: Callable[[], bool]) -> None:
    """Return once it holds; fail where it does not for 20 s."""
    end = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def trickle(connection: socket.socket, data: bytes) -> bytes:
    """Send a byte every 50 ms until the other side closes: what it answered."""
    connection.settimeout(0.05)
    end = time.monotonic() + 20
    received = b""
    while time.monotonic() < end:
        with contextlib.suppress(ConnectionError):
            connection.sendall(data[:1])
        data = data[1:] or b"x"
        try:
            chunk = connection.recv(65536)
        except TimeoutError:
            continue
        except ConnectionError:
            return received
        if not chunk:
            return received
        received += chunk
    raise AssertionError("the connection is still open")


def read_answer(connection: socket.socket) -> bytes:
    """One answer of the small application."""
    received = b""
    while not received.endswith(b"0\r\n\r\n"):
        chunk = connection.recv(65536)
        assert chunk, received
        received += chunk
    return received


def test_headers_that_trickle_in_are_ended() -> None:
    upload = Upload()
    with served(upload, HURRIED) as server:
        with server.connect() as connection:
            head, _, body = trickle(connection, b"GET /x HTTP/1.1\r\nX-Long: ").partition(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 408 Request Timeout\r\n")
        assert json.loads(body)["type"] == "urn:boxlift:problem:timeout"
        assert upload.asked == []
        assert server.refused == ["headers"]
        assert httpx.get(server.url).text == "done"
        eventually(lambda: server.connections.open == 0)


def test_a_silent_connection_is_ended_without_an_answer() -> None:
    with served(Upload(), HURRIED) as server:
        with server.connect() as connection:
            assert read_to_end(connection) == b""
        assert server.refused == ["headers"]


def test_headers_of_a_further_request_are_ended_too() -> None:
    upload = Upload()
    with served(upload, HURRIED) as server:
        with server.connect() as connection:
            for _ in range(2):
                connection.sendall(GET)
                assert read_answer(connection).startswith(b"HTTP/1.1 200 ")
            assert trickle(connection, GET[:-2]).startswith(b"HTTP/1.1 408 ")
        assert len(upload.asked) == 2


def test_bytes_after_an_early_answer_do_not_hold_the_connection() -> None:
    async def early(_: Scope, __: Receive, send: Send) -> None:
        await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"0")]})
        await send({"type": "http.response.body"})

    with served(early, HURRIED) as server, server.connect() as connection:
        connection.sendall(b"POST /x HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100000\r\n\r\n")
        assert trickle(connection, b"").count(b"HTTP/1.1 ") == 1


def test_a_patient_client_is_not_hurried() -> None:
    upload = Upload()
    with served(upload, HURRIED) as server, server.connect() as connection:
        connection.sendall(b"POST /x HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\n\r\n")
        for _ in range(5):  # the body has limits of its own
            time.sleep(0.2)
            connection.sendall(b"x")
        assert read_answer(connection).startswith(b"HTTP/1.1 200 ")
        time.sleep(1)  # idle, between two requests
        connection.sendall(GET)
        assert read_answer(connection).startswith(b"HTTP/1.1 200 ")
        assert upload.body_bytes == 5
        assert server.refused == []


def test_a_connection_too_many_is_told_and_the_others_are_served() -> None:
    settings = ServiceSettings(max_connections=3)
    with served(Upload(), settings) as server, contextlib.ExitStack() as held:
        open_ones = [held.enter_context(server.connect()) for _ in range(3)]
        eventually(lambda: server.connections.open == 3)
        for request in (
            GET,
            b"",
            b"POST /x HTTP/1.1\r\nHost: x\r\nContent-Length: 9999999\r\n\r\n" + bytes(9999),
        ):
            with server.connect() as connection:
                connection.sendall(request)
                head, _, body = read_to_end(connection).partition(b"\r\n\r\n")
            assert head.startswith(b"HTTP/1.1 429 Too Many Requests\r\n")
            assert b"\r\nretry-after: 1\r\n" in head.lower() + b"\r\n"
            assert json.loads(body)["type"] == "urn:boxlift:problem:too-busy"
        response = httpx.post(server.url, content=bytes(10**6))
        assert response.status_code == 429
        assert server.refused == ["connections"] * 4
        for connection in open_ones:
            connection.sendall(GET)
            assert read_answer(connection).startswith(b"HTTP/1.1 200 ")
        open_ones[0].close()
        eventually(lambda: server.connections.open == 2)
        assert httpx.get(server.url).text == "done"


def test_hundreds_of_connections_too_many_leave_nothing_behind() -> None:
    settings = ServiceSettings(max_connections=5)
    with served(Upload(), settings) as server:
        with contextlib.ExitStack() as held:
            for _ in range(300):
                held.enter_context(server.connect())
            eventually(lambda: len(server.refused) == 295)
            assert server.connections.open == 5
            assert server.connections.lingering <= 100
        eventually(lambda: server.connections.open == server.connections.lingering == 0)
        assert httpx.get(server.url).text == "done"


def asks_for_much(server: Served) -> socket.socket:
    """A connection that has asked for an answer that no buffer of the system holds."""
    connection = socket.socket()
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 65536)
    connection.settimeout(20)
    connection.connect((server.host, server.port))
    connection.sendall(GET)
    return connection


def test_an_answer_that_nobody_takes_is_dropped() -> None:
    with served(Upload(answer=bytes(2**25)), HURRIED) as server, asks_for_much(server):
        eventually(lambda: server.refused == ["unread"])
        eventually(lambda: server.connections.open == 0)


def test_an_answer_that_is_taken_slowly_is_not_dropped() -> None:
    answer = bytes(2**25)
    settings = ServiceSettings(receive_limit_s=1)
    with served(Upload(answer=answer), settings) as server, asks_for_much(server) as connection:
        taken = 0
        for _ in range(40):
            time.sleep(0.1)
            taken += len(connection.recv(50_000))
        taken += len(read_answer(connection))
        assert taken > len(answer)
        assert server.refused == []


def test_a_body_that_breaks_while_it_is_answered_ends_its_connection_alone(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def echo(_: Scope, receive: Receive, send: Send) -> None:
        await send({"type": "http.response.start", "status": 200, "headers": []})
        while (message := await receive())["type"] == "http.request":
            await send({"type": "http.response.body", "body": message["body"], "more_body": True})

    caplog.set_level(logging.WARNING)
    head = b"POST /x HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n"
    with served(echo) as server, server.connect() as connection:
        connection.sendall(head + b"4\r\nbody\r\n")
        received = b""
        while not received.endswith(b"body\r\n"):
            received += connection.recv(65536)
        connection.sendall(b"no length\r\n")
        assert read_to_end(connection) == b""
        assert received.count(b"HTTP/1.1 ") == 1
        eventually(lambda: server.connections.open == 0)
    assert [record for record in caplog.records if record.levelno >= logging.ERROR] == []


def test_the_limit_of_open_files_is_raised_as_far_as_it_goes() -> None:
    program = (
        "import logging, resource; from boxlift_service.settings import ServiceSettings\n"
        "from boxlift_service.guards.connections import allow_open_files; logging.basicConfig()\n"
        "resource.setrlimit(resource.RLIMIT_NOFILE, (200, 4000))\n"
        "for most in (100, 5000, 1):\n"
        "    allow_open_files(ServiceSettings(max_connections=most))\n"
        "    print(resource.getrlimit(resource.RLIMIT_NOFILE)[0])"
    )
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert [int(line) for line in ran.stdout.split()] == [2504, 4000, 4000]
    assert "BOXLIFT_MAX_CONNECTIONS=5000" in ran.stderr
    assert ran.stderr.count("WARNING") == 1
