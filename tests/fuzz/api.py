"""Asks every route of a running service, and holds every answer against its OpenAPI document.

Asked is what schemathesis makes of the document, and what is nearly right (fuzz.requests). No answer is a
5xx; its status, media type, headers and body are as documented.
"""

from __future__ import annotations

import contextlib
import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from http.client import HTTPConnection
from random import Random
from typing import Any, Self

import httpx
import hypothesis
import msgpack
import requests
import schemathesis
from hypothesis import HealthCheck, Phase
from hypothesis.errors import Unsatisfiable
from schemathesis import Case, GenerationMode
from schemathesis.checks import not_a_server_error
from schemathesis.core.failures import FailureGroup
from schemathesis.core.result import Ok
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from fuzz.requests import BATCH, DETECT, LABEL, RECOGNITION, damaged_request
from service.file_server import FileServer, file_server
from service.running import RunningService, running_service

_CHECKS = [
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
]
_RELOAD = "POST /models:reload"
# Shares of the cases, by what is behind a route. A reload takes seconds, whatever is sent.
_SHARES = {LABEL: 30, DETECT: 15, BATCH: 15, RECOGNITION: 10, _RELOAD: 0.02}
_OTHER_SHARE = 4.0
_NEARLY_RIGHT = (LABEL, DETECT, BATCH, RECOGNITION)
_METHODS = ("GET", "POST", "PUT", "DELETE", "PATCH", "HEAD", "OPTIONS", "TRACE", "BREW", "G!T", "get")
_TAILS = (
    "",
    "/",
    "//",
    "?a=%00",
    "?%ff=%",
    "/..",
    "/%2e%2e/healthz",
    ";a",
    "%20",
    "/" + "a" * 2000,
    "?" + "a&" * 2000,
)
_HEADERS = (
    *(
        ("Accept", ";;q=,"),
        ("Accept-Encoding", "gzip;q=x, *"),
        ("Range", "bytes=0-,-1"),
        ("Expect", "200-ok"),
    ),
    *(
        ("X-Request-ID", "a" * 5000),
        ("X-Request-ID", "\x7f"),
        ("traceparent", "00-" + "f" * 50),
        ("Cookie", "a"),
    ),
    *(("Content-Type", "multipart/form-data; boundary="), ("Content-Encoding", "gzip"), ("Upgrade", "h2c")),
    *(("Authorization", "Bearer \u00e9\x7f"), ("Forwarded", "for=unknown"), ("Sec-Fetch-Site", "cross-site")),
)
# What would be a 5xx by itself, in an answer about several.
_WITHIN = {
    BATCH: re.compile(r'"status": ?50[0-3].*'),
    RECOGNITION: re.compile(r'"(INTERNAL_ERROR|WORKER_DIED|MODEL_FAILED|NO_DETECTOR|NOT_READY)".*'),
}
# A client that asks for too short a time is answered with 504: that is no failure.
_GAVE_A_TIME = "x-request-timeout"


@schemathesis.serializer("application/msgpack")
def _as_msgpack(_: schemathesis.SerializationContext, value: Any) -> bytes:
    """Maps, of what is given as one or as a list."""
    if isinstance(value, bytes):
        return value
    packed: list[bytes] = [_packed(item) for item in (value if isinstance(value, list) else [value])]
    return b"".join(packed)


def _packed(value: Any) -> bytes:
    try:
        packed: bytes = msgpack.packb(value, default=str)
    except (OverflowError, ValueError):  # integers beyond 64 bits, half surrogates
        return repr(value).encode()
    return packed


@dataclass
class RouteReport:
    """What a route was asked and answered."""

    cases: int = 0
    statuses: Counter[int] = field(default_factory=Counter)
    findings: list[str] = field(default_factory=list)


class ApiFuzzer:
    """Asks the service at `url`, which may fetch from `store`."""

    def __init__(self, url: str, store: FileServer, seed: int = 0) -> None:
        schema = schemathesis.openapi.from_url(f"{url}/openapi.json")
        self._url = url
        self._store = store
        self._seed = seed
        found = [result.ok() for result in schema.get_all_operations() if isinstance(result, Ok)]
        self._operations = {operation.label: operation for operation in found}
        self._address = url.removeprefix("http://")
        self._client = httpx.Client(base_url=url, timeout=120)
        self._session = requests.Session()
        self.reports = {label: RouteReport() for label in (*self._operations, "anything else")}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._client.close()
        self._session.close()

    def run(self, cases: int, on_route: Callable[[str, RouteReport], None] = lambda *_: None) -> None:
        """About so many cases over all routes."""
        shares = {label: _SHARES.get(label, _OTHER_SHARE) for label in self.reports}
        for label, report in self.reports.items():
            count = max(2, round(cases * shares[label] / sum(shares.values())))
            if label in _NEARLY_RIGHT:
                self._ask_schemathesis(label, count // 3)
                self._ask_nearly_right(label, count - report.cases)
            elif label in self._operations:
                self._ask_schemathesis(label, count // 2)
                self._ask_wildly(label, count - report.cases)
            else:
                self._ask_wildly(label, count)
            on_route(label, report)

    def ask_nearly_right(self, label: str, seed: int) -> None:
        """One request of fuzz.requests; what is wrong with its answer is in `reports`."""
        asked = damaged_request(label, seed, self._store.url)
        self._store.files.clear()
        self._store.files.update(asked.files)
        response = self._client.post(asked.path, headers=asked.headers, content=asked.body)
        self._judge(label, response, f"nearly right, seed {seed}", _GAVE_A_TIME in response.request.headers)

    def _ask_nearly_right(self, label: str, count: int) -> None:
        for index in range(count):
            self.ask_nearly_right(label, self._seed * 1_000_003 + index)

    def _ask_schemathesis(self, label: str, count: int) -> None:
        for mode in (GenerationMode.POSITIVE, GenerationMode.NEGATIVE):
            # Of a route that takes nothing, nothing can be wrong.
            with contextlib.suppress(Unsatisfiable):
                self._ask_generated(label, mode, max(1, count // 2))

    def _ask_generated(self, label: str, mode: GenerationMode, count: int) -> None:
        @hypothesis.seed(self._seed)
        @hypothesis.settings(
            max_examples=count,
            deadline=None,
            database=None,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )
        @hypothesis.given(self._operations[label].as_strategy(generation_mode=mode))
        def ask(case: Case[Any]) -> None:
            response = case.call(self._url, session=self._session, timeout=120)
            gave_a_time = _GAVE_A_TIME in {name.lower() for name in (case.headers or {})}
            self._judge(label, response, f"schemathesis: {case.as_curl_command():.500}", gave_a_time, case)

        ask()

    def _ask_wildly(self, label: str, count: int) -> None:
        """Any method, path, headers and body, as they are: http.client does not put them right."""
        random = Random(f"{self._seed} {label}")
        paths = (
            [label.partition(" ")[2]]
            if label in self._operations
            else ["/openapi.json", "/", "/v2/label", "/*"]
        )
        for _ in range(count):
            where = (
                random.choice(("", "/v1"))
                + random.choice(paths)
                + random.choice(("", "", random.choice(_TAILS)))
            )
            own_method = label.partition(" ")[0] if label in self._operations else "GET"
            method = random.choice((own_method, random.choice(_METHODS)))
            headers = dict(random.sample(_HEADERS, random.choice((0, 1, 3))))
            body = random.randbytes(random.choice((0, 0, 1, 300)))
            connection = HTTPConnection(self._address, timeout=120)
            with contextlib.closing(connection):
                connection.request(method, where, body, headers)
                status = connection.getresponse().status
            report = self.reports[label]
            report.cases += 1
            report.statuses[status] += 1
            if status >= 500:
                report.findings.append(f"{method} {where:.100} {headers}: {status}")

    def _judge(
        self, label: str, response: Any, what: str, gave_a_time: bool, case: Case[Any] | None = None
    ) -> None:
        report = self.reports[label]
        report.cases += 1
        report.statuses[response.status_code] += 1
        checks = [
            check
            for check in _CHECKS
            if check is not not_a_server_error or not (gave_a_time and response.status_code == 504)
        ]
        case = case or self._operations[label].Case()
        problems: list[str] = []
        try:
            case.validate_response(response, checks=checks)
        except FailureGroup as error:
            problems += [f"{type(problem).__name__} {problem!s:.300}" for problem in error.exceptions]
        if (
            response.status_code == 200
            and label in _WITHIN
            and (found := _WITHIN[label].search(response.text))
        ):
            problems.append(f"within the answer {found[0]:.300}")
        if problems:
            report.findings.append(f"{label}, {what}: {response.status_code}: {'; '.join(problems)}")


@contextlib.contextmanager
def fuzzed_service() -> Iterator[tuple[RunningService, FileServer]]:
    """A service with the models that ship and limits that requests reach, and the store it may fetch from."""
    limits = {"max_points": "100000", "max_prompts": "50", "max_image_pixels": "4000000", "max_images": "4"}
    with (
        file_server() as store,
        running_service(fetch_from=f"{store.url}/", fetch_private="true", **limits) as service,
    ):
        yield service, store
