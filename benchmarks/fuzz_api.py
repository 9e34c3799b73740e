"""Asks every route of the real service, many times: no 5xx, and every answer is as OpenAPI documents it.

    python benchmarks/fuzz_api.py [--cases 20000] [--seed 0]

A third is what schemathesis makes of /openapi.json, right and wrong. Forms it makes are wrong at once, so
the rest are frames, images, streams and sweeps that are nearly right (tests/fuzz/requests.py), and any
method, path and header. Not 5xx: 504 where the client gave a time, X-Request-Timeout. Prints a table of
routes; the exit status is 1 where something was found. tests/fuzz/test_api.py is the short form.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from fuzz.api import ApiFuzzer, RouteReport, fuzzed_service


def main() -> int:
    """Ask and print; 1 where something was found."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    print("| route | cases | answers by status | findings |")
    print("|---|---|---|---|")

    def tell(label: str, report: RouteReport) -> None:
        statuses = ", ".join(f"{status}: {count}" for status, count in sorted(report.statuses.items()))
        print(f"| {label} | {report.cases} | {statuses} | {len(report.findings)} |", flush=True)

    start = time.monotonic()
    with fuzzed_service() as (service, store), ApiFuzzer(service.url, store, arguments.seed) as fuzzer:
        fuzzer.run(arguments.cases, tell)
    reports = fuzzer.reports.values()
    print(f"{sum(report.cases for report in reports)} cases in {time.monotonic() - start:.0f} s")
    findings = [finding for report in reports for finding in report.findings]
    for finding in findings:
        print(finding)
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
