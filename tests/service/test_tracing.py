from __future__ import annotations

import http.server
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import time_ns

import httpx
import pytest
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest
from opentelemetry.proto.trace.v1.trace_pb2 import Span, Status
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route

import boxlift
from boxlift_service.telemetry.metrics import Metrics
from boxlift_service.telemetry.observation import ObservationMiddleware
from boxlift_service.telemetry.timing import RequestTimes
from boxlift_service.telemetry.tracing import Tracing
from service.frames import SmallFrame
from service.running import running_service
from service.served import served


@dataclass
class Collector:
    """What an OpenTelemetry collector has been sent."""

    url: str = ""
    paths: list[str] = field(default_factory=list)
    requests: list[ExportTraceServiceRequest] = field(default_factory=list)

    @property
    def spans(self) -> list[Span]:
        return [
            span
            for request in self.requests
            for resource in request.resource_spans
            for scope in resource.scope_spans
            for span in scope.spans
        ]

    @property
    def resource(self) -> dict[str, object]:
        """Attributes of the one that sent."""
        return attributes(self.requests[0].resource_spans[0].resource)

    def server_span(self) -> Span:
        (found,) = [span for span in self.spans if span.kind == Span.SPAN_KIND_SERVER]
        return found


@pytest.fixture
def collector(monkeypatch: pytest.MonkeyPatch) -> Iterator[Collector]:
    """An OTLP/HTTP receiver on a free port, to which the variables point."""
    collected = Collector()

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            collected.paths.append(self.path)
            collected.requests.append(ExportTraceServiceRequest.FromString(body))
            self.send_response(200)
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002 -- its name there
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.05,))
        thread.start()
        collected.url = f"http://127.0.0.1:{server.server_port}"
        monkeypatch.setenv("OTEL_EXPORTER_OTLP_ENDPOINT", collected.url)
        yield collected
        server.shutdown()
        thread.join()


def attributes(of: object) -> dict[str, object]:
    return {
        item.key: getattr(item.value, item.value.WhichOneof("value"))
        for item in of.attributes  # type: ignore[attr-defined]
    }


async def _label(request: Request) -> Response:
    times: RequestTimes = request.state.times
    with times.stage("receive"):
        await request.body()
    times.seconds["queue"] = 0.25
    times.seconds.update({"decode": 0.5, "fit": 1.0})
    with times.stage("encode"):
        pass
    return PlainTextResponse("done", int(request.query_params.get("status", 200)))


@contextmanager
def traced() -> Iterator[str]:
    """URL of a small service; all its spans have been sent when it ends."""
    app = Starlette(routes=[Route("/label", _label, methods=["POST"])])
    tracing = Tracing()
    with served(ObservationMiddleware(app, Metrics(), {"/label"}, tracing)) as server:
        yield server.url
    tracing.shutdown()


def test_request_is_a_span_with_its_stages_below(collector: Collector) -> None:
    begin_ns = time_ns()
    with traced() as url:
        headers = {"X-Request-ID": "4711", "User-Agent": "a client"}
        httpx.post(f"{url}/label?status=200", content=b"body", headers=headers)
    end_ns = time_ns()

    assert collector.paths == ["/v1/traces"]
    assert collector.resource["service.name"] == "boxlift"
    assert collector.resource["service.version"] == boxlift.__version__
    span = collector.server_span()
    assert span.name == "POST /label"
    assert begin_ns <= span.start_time_unix_nano < span.end_time_unix_nano <= end_ns
    found = attributes(span)
    assert found.pop("client.address") == "127.0.0.1"
    assert found == {
        "http.request.method": "POST",
        "http.route": "/label",
        "http.response.status_code": 200,
        "url.scheme": "http",
        "url.path": "/label",
        "network.protocol.version": "1.1",
        "user_agent.original": "a client",
        "boxlift.request_id": "4711",
    }
    stages = [other for other in collector.spans if other.span_id != span.span_id]
    assert [stage.name for stage in stages] == ["receive", "queue", "decode", "fit", "encode"]
    assert {stage.parent_span_id for stage in stages} == {span.span_id}
    assert {stage.trace_id for stage in stages} == {span.trace_id}
    receive, queue, decode, fit, encode = stages
    assert span.start_time_unix_nano <= receive.start_time_unix_nano < receive.end_time_unix_nano
    # Of these only the seconds are known.
    assert queue.start_time_unix_nano == receive.end_time_unix_nano
    assert decode.start_time_unix_nano == pytest.approx(queue.start_time_unix_nano + 250_000_000, abs=1000)
    assert fit.end_time_unix_nano - fit.start_time_unix_nano == pytest.approx(1_000_000_000, abs=1000)
    # And this was timed here.
    assert receive.end_time_unix_nano <= encode.start_time_unix_nano <= span.end_time_unix_nano


def test_trace_of_the_caller_goes_on(collector: Collector) -> None:
    trace_id, caller = "0af7651916cd43dd8448eb211c80319c", "b7ad6b7169203331"
    with traced() as url:
        headers = {"traceparent": f"00-{trace_id}-{caller}-01", "tracestate": "vendor=1"}
        httpx.post(f"{url}/label", headers=headers)

    span = collector.server_span()
    assert (span.trace_id.hex(), span.parent_span_id.hex()) == (trace_id, caller)
    assert span.trace_state == "vendor=1"


@pytest.mark.parametrize(
    "traceparent", ["00-zz-zz-01", "x" * 5000, "", "00-" + "0" * 32 + "-" + "0" * 16 + "-01"]
)
def test_odd_traceparent_begins_a_trace(collector: Collector, traceparent: str) -> None:
    with traced() as url:
        assert httpx.post(f"{url}/label", headers={"traceparent": traceparent}).status_code == 200

    span = collector.server_span()
    assert not span.parent_span_id
    assert any(span.trace_id)


def test_caller_that_does_not_sample_is_heeded(collector: Collector) -> None:
    with traced() as url:
        headers = {"traceparent": f"00-{'1' * 32}-{'2' * 16}-00"}
        assert httpx.post(f"{url}/label", headers=headers).status_code == 200

    assert collector.requests == []


@pytest.mark.parametrize(
    ("status", "code"), [(500, Status.STATUS_CODE_ERROR), (422, Status.STATUS_CODE_UNSET)]
)
def test_fault_of_ours_is_an_error(collector: Collector, status: int, code: int) -> None:
    with traced() as url:
        httpx.post(f"{url}/label?status={status}")

    span = collector.server_span()
    assert span.status.code == code
    assert attributes(span)["http.response.status_code"] == status


def test_variables_name_the_service_and_the_sampler(
    collector: Collector, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OTEL_SERVICE_NAME", "labels-of-berlin")
    monkeypatch.setenv("OTEL_RESOURCE_ATTRIBUTES", "deployment.environment.name=test")
    with traced() as url:
        httpx.post(f"{url}/label")
    assert collector.resource["service.name"] == "labels-of-berlin"
    assert collector.resource["deployment.environment.name"] == "test"

    collector.requests.clear()
    monkeypatch.setenv("OTEL_TRACES_SAMPLER", "always_off")
    with traced() as url:
        httpx.post(f"{url}/label")
    assert collector.requests == []


def test_service_answers_while_no_collector_does(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OTEL_EXPORTER_OTLP_ENDPOINT", "http://127.0.0.1:9")
    monkeypatch.setenv("OTEL_EXPORTER_OTLP_TIMEOUT", "1")
    with traced() as url:
        assert httpx.post(f"{url}/label").text == "done"


def test_missing_extra_names_itself() -> None:
    program = """
import sys
sys.modules["opentelemetry"] = None
from boxlift_service.telemetry.observation import start_tracing
try:
    start_tracing()
except ImportError as error:
    print(error)
"""
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, env=dict(os.environ)
    )
    assert ended.stdout.strip().endswith("install it with: pip install 'boxlift[otel]'.")


def test_service_sends_the_last_trace_before_it_ends(collector: Collector, frame: SmallFrame) -> None:
    with running_service(tracing="true") as service:
        response = service.label(frame.fields())
        assert response.status_code == 200

    (label,) = [span for span in collector.spans if span.name == "POST /label"]
    assert attributes(label)["boxlift.request_id"] == response.headers["x-request-id"]
    stages = {span.name: span for span in collector.spans if span.parent_span_id == label.span_id}
    assert {"receive", "queue", "decode", "ground", "fit", "encode"} <= set(stages)
    for stage in stages.values():
        assert label.start_time_unix_nano <= stage.start_time_unix_nano
        assert stage.end_time_unix_nano <= label.end_time_unix_nano
