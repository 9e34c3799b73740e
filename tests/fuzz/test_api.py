"""The short form of benchmarks/fuzz_api.py: some hundred cases over all routes of a real service."""

from __future__ import annotations

from fuzz.api import ApiFuzzer, fuzzed_service

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
