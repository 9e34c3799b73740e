"""The short form of benchmarks/fuzz_api.py: some hundred cases over all routes of a real service."""

from __future__ import annotations

import json

from fuzz.api import ApiFuzzer, fuzzed_service
from service.file_server import answer, file_server

CASES = 400


def test_every_answer_is_as_documented_and_none_is_a_5xx() -> None:
    with fuzzed_service() as (service, store), ApiFuzzer(service.url, store) as fuzzer:
        fuzzer.run(CASES)
        assert service.client.get("/readyz").status_code == 200
    assert [finding for report in fuzzer.reports.values() for finding in report.findings] == []
    assert sum(report.cases for report in fuzzer.reports.values()) >= 0.9 * CASES
    for label, report in fuzzer.reports.items():
        assert report.statuses[200], f"{label} never succeeds"
        assert report.statuses.keys() - {200} or report.cases < 5, f"{label} never refuses"


def test_a_service_that_does_not_do_as_it_says_is_found() -> None:
    content = {"application/json": {"schema": {"type": "object"}}}
    documented = {"get": {"responses": {"200": {"description": "An object.", "content": content}}}}
    as_json = {"Content_Type": "application/json"}
    answers = {
        "/fails": (answer(b"{}", 500, **as_json), "ServerError"),
        "/status": (answer(b"{}", 418, **as_json), "UndefinedStatusCode"),
        "/type": (answer(b"{}", 200, Content_Type="text/plain"), "UndefinedContentType"),
        "/body": (answer(b'"text"', 200, **as_json), "JsonSchemaError"),
        "/right": (answer(b"{}", 200, **as_json), ""),
    }
    document = {
        "openapi": "3.1.0",
        "info": {"title": "liar", "version": "1"},
        "paths": dict.fromkeys(answers, documented),
    }
    with file_server() as liar:
        liar.files["/openapi.json"] = answer(json.dumps(document).encode(), 200, **as_json)
        liar.files.update({path: given for path, (given, _) in answers.items()})
        with ApiFuzzer(liar.url, liar) as fuzzer:
            fuzzer.run(10)
    for path, (_, kind) in answers.items():
        found = [finding for finding in fuzzer.reports[f"GET {path}"].findings if "schemathesis" in finding]
        assert all(kind in finding for finding in found)
        assert bool(found) == bool(kind), path
