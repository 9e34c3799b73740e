from __future__ import annotations

import asyncio
import logging
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi import APIRouter, FastAPI, Request
from starlette.requests import ClientDisconnect
from starlette.responses import PlainTextResponse, Response, StreamingResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from boxlift_service.app import create_app
from boxlift_service.settings import ServiceSettings
from boxlift_service.telemetry.logs import of_request
from boxlift_service.telemetry.metrics import Metrics
from boxlift_service.telemetry.observation import ObservationMiddleware
from service.served import Served, served
from service.test_metrics import scraped

PATHS = {"/label", "/faulty", "/readyz", "/endless"}


class DoorMiddleware:
    """Answers /label 401 where no key comes along, as an inner layer does that knows no routes."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http" and scope["path"].endswith("/label"):
            key = dict(scope["headers"]).get(b"authorization")
            if key is None:
                await PlainTextResponse("no key", 401)(scope, receive, send)
                return
            scope["state"]["key"] = key.decode("latin-1")
        await self._app(scope, receive, send)


def routes() -> APIRouter:
    found = APIRouter()

    @found.post("/label")
    async def label(request: Request) -> Response:
        with request.state.times.stage("receive"):
            body = await request.body()
        request.state.times.seconds["fit"] = 2.0
        return PlainTextResponse(f"{request.state.request_id} {len(body)}")

    @found.get("/faulty")
    async def faulty() -> Response:
        raise RuntimeError("secret insides")

    @found.get("/readyz")
    async def readyz(ready: bool = True) -> Response:
        return PlainTextResponse("", 200 if ready else 503)

    @found.get("/endless")
    async def endless(breaks: bool = False) -> Response:
        async def chunks() -> Any:
            while True:
                yield b"chunk\n"
                if breaks:
                    raise RuntimeError("secret insides")
                await asyncio.sleep(0.01)

        return StreamingResponse(chunks())

    return found


@dataclass
class Observed:
    """A small service, and what it tells."""

    server: Served
    metrics: Metrics

    @property
    def url(self) -> str:
        return self.server.url


@contextmanager
def observed(app: ASGIApp | None = None) -> Iterator[Observed]:
    metrics = Metrics()
    with served(observed_routes(metrics) if app is None else within(app, metrics)) as server:
        yield Observed(server, metrics)


def observed_routes(metrics: Metrics) -> FastAPI:
    """The routes, with the door within and the observation around, as the service has them."""
    app = FastAPI()
    app.include_router(routes())
    app.include_router(routes(), prefix="/v1")
    app.add_middleware(DoorMiddleware)
    app.add_middleware(ObservationMiddleware, metrics=metrics, paths=PATHS)
    return app


def within(app: ASGIApp, metrics: Metrics) -> ObservationMiddleware:
    return ObservationMiddleware(app, metrics, PATHS)


def counted(metrics: Metrics) -> dict[str, float]:
    """Requests by `METHOD ROUTE STATUS`."""
    return {
        re.sub(r"\S+ method=(.*) route=(.*) status=(.*)", r"\1 \2 \3", name): value
        for name, value in scraped(metrics).items()
        if name.startswith("boxlift_requests_total")
    }


@pytest.fixture
def lines(caplog: pytest.LogCaptureFixture) -> Callable[[], list[str]]:
    """The lines logged by now, one a request, without their milliseconds."""
    caplog.set_level(logging.INFO, "boxlift_service")
    return lambda: [
        re.sub(r"[0-9.]+ ms", "", record.getMessage())
        for record in caplog.records
        if record.name == "boxlift_service.requests" and hasattr(record, "fields")
    ]


def test_usable_id_is_echoed_and_another_is_made() -> None:
    with observed() as service, httpx.Client(base_url=service.url) as client:
        answered = [
            client.get("/readyz", headers={b"X-Request-ID": given.encode("latin-1")}).headers["x-request-id"]
            for given in ("frame-17/a:b", "x" * 128, "x" * 129, 'a"b', "", "a b", "ü")
        ]

    assert answered[:2] == ["frame-17/a:b", "x" * 128]
    made = answered[2:]
    assert all(re.fullmatch("[0-9a-f]{32}", request_id) for request_id in made)
    assert len(set(made)) == len(made)


def test_id_and_times_reach_the_route() -> None:
    with observed() as service:
        headers = {"X-Request-ID": "4711", "Authorization": "team-a"}
        response = httpx.post(f"{service.url}/label", content=b"12345", headers=headers)

    assert response.text == "4711 5"
    found = scraped(service.metrics)
    assert found["boxlift_stage_seconds_sum route=/label stage=fit"] == 2
    assert found["boxlift_stage_seconds_count route=/label stage=receive"] == 1
    assert found["boxlift_request_seconds_count route=/label"] == 1


def test_each_request_is_a_line(lines: Callable[[], list[str]], caplog: pytest.LogCaptureFixture) -> None:
    with observed() as service:
        httpx.post(f"{service.url}/label", headers={"Authorization": "team-a"})
        httpx.get(f"{service.url}/nothing%0A/here?token=secret")

    assert lines() == ["POST /label (key team-a) 200 in ", "GET other '/nothing\\n/here' 404 in "]
    fields = [record.fields for record in caplog.records if hasattr(record, "fields")]
    assert [record.pop("ms") >= 0 for record in fields] == [True, True]
    assert fields == [
        {"method": "POST", "route": "/label", "status": 200, "key": "team-a"},
        {"method": "GET", "route": "other", "status": 404, "path": "/nothing\n/here"},
    ]
    assert "secret" not in caplog.text


def test_labels_are_few_whatever_clients_send(lines: Callable[[], list[str]]) -> None:
    with observed() as service, httpx.Client(base_url=service.url) as client:
        client.post("/label", headers={"Authorization": "k"})
        client.post("/v1/label", headers={"Authorization": "k"})
        client.post("/v1/label")  # refused before the routes
        client.get("/v1/label", headers={"Authorization": "k"})
        for number in range(5):
            client.get(f"/label/{number}")
            client.get(f"/v1/v1/{number}")
            client.request(f"BREW{number}", "/readyz")

    assert counted(service.metrics) == {
        "POST /label 200": 2,
        "POST /label 401": 1,
        "GET /label 405": 1,
        "GET other 404": 10,
        "other /readyz 405": 5,
    }
    assert len(lines()) == 19


def test_probes_are_told_only_where_something_is_wrong(lines: Callable[[], list[str]]) -> None:
    with observed() as service:
        httpx.get(f"{service.url}/readyz")
        httpx.get(f"{service.url}/v1/readyz?ready=false")

    assert lines() == ["GET /readyz 503 in "]
    assert counted(service.metrics) == {"GET /readyz 200": 1, "GET /readyz 503": 1}


def test_fault_is_a_problem_with_the_id_and_the_log_has_its_cause(
    lines: Callable[[], list[str]], caplog: pytest.LogCaptureFixture
) -> None:
    ids = []

    class Noting(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if record.exc_info:
                ids.append((of_request.get() or {}).get("request_id"))

    noting = Noting()
    logging.getLogger("boxlift_service").addHandler(noting)
    try:
        with observed(_faulty_app) as service:
            response = httpx.get(f"{service.url}/faulty", headers={"X-Request-ID": "4711"})
    finally:
        logging.getLogger("boxlift_service").removeHandler(noting)

    assert response.status_code == 500
    assert response.headers["content-type"] == "application/problem+json"
    assert response.headers["x-request-id"] == "4711"
    assert response.json()["type"] == "urn:boxlift:problem:internal-error"
    assert "4711" in response.json()["detail"]
    assert "secret" not in response.text
    assert "RuntimeError: secret insides" in caplog.text
    assert ids == ["4711"]
    assert lines() == ["GET /faulty 500 in "]
    assert counted(service.metrics) == {"GET /faulty 500": 1}


async def _faulty_app(_: Scope, __: Receive, ___: Send) -> None:
    raise RuntimeError("secret insides")


def test_an_answer_that_breaks_off_is_no_success() -> None:
    with observed() as service, pytest.raises(httpx.RemoteProtocolError):
        httpx.get(f"{service.url}/endless?breaks=true")

    assert counted(service.metrics) == {"GET /endless 500": 1}


def test_client_that_vanishes_while_it_sends_is_499(lines: Callable[[], list[str]]) -> None:
    with observed() as service, service.server.connect() as connection:
        connection.sendall(
            b"POST /label HTTP/1.1\r\nHost: x\r\nAuthorization: k\r\nContent-Length: 1000\r\n\r\nfew bytes"
        )

    assert counted(service.metrics) == {"POST /label 499": 1}
    assert lines() == ["POST /label (key k) 499 in "]


def test_client_that_vanishes_while_it_is_answered_is_499() -> None:
    with observed() as service, httpx.stream("GET", f"{service.url}/endless") as response:
        next(response.iter_lines())

    assert counted(service.metrics) == {"GET /endless 499": 1}


def test_answer_that_was_complete_stays_what_it_was() -> None:
    async def vanishing(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http":
            await PlainTextResponse("all of it")(scope, receive, send)
            raise ClientDisconnect

    with observed(vanishing) as service:
        assert httpx.get(f"{service.url}/label").text == "all of it"

    assert counted(service.metrics) == {"GET /label 200": 1}


def test_request_that_is_given_up_by_the_server_is_told() -> None:
    async def waiting(_: Scope, __: Receive, ___: Send) -> None:
        await asyncio.Event().wait()

    async def give_up() -> None:
        task = asyncio.create_task(_call(within(waiting, metrics)))
        await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    metrics = Metrics()
    asyncio.run(give_up())

    assert counted(metrics) == {"GET /label 500": 1}


def test_lingering_close_is_no_part_of_the_duration() -> None:
    answered_s = []

    async def lingering(scope: Scope, _: Receive, send: Send) -> None:
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": b"all of it", "more_body": True})
        answered_s.append(scope["state"]["times"].since_start())
        await asyncio.sleep(0.01)
        await send({"type": "http.response.body"})

    metrics = Metrics()
    asyncio.run(_call(within(lingering, metrics)))

    assert counted(metrics) == {"GET /label 200": 1}
    assert 0 < scraped(metrics)["boxlift_request_seconds_sum route=/label"] <= answered_s[0]


def test_what_the_service_refuses_before_its_routes_is_told_by_route(tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    keys.write_text(f"somebody {'0' * 64}\n")
    metrics = Metrics()
    with served(create_app(ServiceSettings(api_keys=keys), metrics)) as server:
        for path in ("/label", "/v1/detect", "/metrics", "/openapi.json", "/nothing"):
            assert httpx.get(f"{server.url}{path}").status_code == 401

    assert counted(metrics) == {
        f"GET {route} 401": 1 for route in ("/label", "/detect", "/metrics", "/openapi.json", "other")
    }


async def _call(app: ASGIApp) -> None:
    """One GET /label, whose answer nobody reads."""

    async def receive() -> Message:
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(_: Message) -> None:
        pass

    await app({"type": "http", "method": "GET", "path": "/label", "headers": []}, receive, send)
