"""A trace of every request, sent to an OpenTelemetry collector over OTLP/HTTP (extra `otel`)."""

from __future__ import annotations

from threading import Thread

from opentelemetry.context import Context
from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
from opentelemetry.sdk.resources import OTELResourceDetector, Resource
from opentelemetry.sdk.trace import TracerProvider
from opentelemetry.sdk.trace.export import BatchSpanProcessor
from opentelemetry.trace import Span, SpanKind, StatusCode, format_trace_id, set_span_in_context
from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator
from starlette.datastructures import Headers
from starlette.types import Scope

import boxlift
from boxlift_service.telemetry.timing import RequestTimes

_LAST_FLUSH_S = 5.0
_MAX_LENGTH = 256


class Tracing:
    """A server span for each request, with a child for each of its stages.

    The standard OTEL_* variables say where spans go, which are sampled and what the service is called.
    Spans are sent from a thread, in batches; those of a collector that is away are lost in the end.
    """

    def __init__(self) -> None:
        resource = Resource.create({"service.name": "boxlift", "service.version": boxlift.__version__})
        # Given to `create`, our name would win over OTEL_SERVICE_NAME.
        resource = resource.merge(OTELResourceDetector().detect())
        self._provider = TracerProvider(resource=resource, shutdown_on_exit=False)
        self._provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter()))
        self._tracer = self._provider.get_tracer("boxlift_service", boxlift.__version__)
        self._propagator = TraceContextTextMapPropagator()

    def begin(self, scope: Scope, method: str, times: RequestTimes) -> Span:
        """The span of a request, a child of the one that its header `traceparent` names."""
        headers = Headers(scope=scope)
        carrier = {name: headers[name] for name in ("traceparent", "tracestate") if name in headers}
        attributes = {
            "http.request.method": method,
            "url.scheme": scope["scheme"],
            "url.path": scope["path"][:_MAX_LENGTH],
            "user_agent.original": headers.get("user-agent", "")[:_MAX_LENGTH],
            "network.protocol.version": scope["http_version"],
        }
        if scope.get("client"):
            attributes["client.address"] = scope["client"][0]
        return self._tracer.start_span(
            method,
            self._propagator.extract(carrier, Context()),
            SpanKind.SERVER,
            {name: value for name, value in attributes.items() if value},
            start_time=times.clock_ns(),
        )

    def end(
        self, span: Span, times: RequestTimes, *, method: str, route: str, status: int, request_id: str
    ) -> None:
        """End the span of a request that has been answered, and make those of its stages."""
        if not span.is_recording():
            return
        span.update_name(f"{method} {route}")
        span.set_attributes(
            {"http.route": route, "http.response.status_code": status, "boxlift.request_id": request_id}
        )
        if status >= 500:
            span.set_attribute("error.type", str(status))
            span.set_status(StatusCode.ERROR)
        for stage, begin_ns, end_ns in times.spans():
            child = self._tracer.start_span(stage, set_span_in_context(span, Context()), start_time=begin_ns)
            child.end(end_ns)
        span.end()

    @staticmethod
    def trace_id(span: Span) -> str:
        """32 hexadecimal digits."""
        return format_trace_id(span.get_span_context().trace_id)

    def shutdown(self) -> None:
        """Send what has not been sent, for some seconds at most; blocks."""
        last_flush = Thread(target=self._provider.shutdown, daemon=True)
        last_flush.start()
        last_flush.join(_LAST_FLUSH_S)
