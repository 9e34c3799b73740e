from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import httpx
import pytest
from fastapi import FastAPI
from prometheus_client.parser import text_string_to_metric_families

import boxlift
from boxlift_service.routes.metrics import metrics_routes
from boxlift_service.telemetry.metrics import Metrics, PoolState, resident_bytes
from service.frames import SmallFrame
from service.running import RunningService
from service.served import served

needs_proc = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="the system has no /proc")


def samples(exposition: bytes) -> dict[str, float]:
    """Value of every series, which is written as its name with its labels in alphabetical order."""
    return {
        sample.name
        + "".join(f" {name}={value}" for name, value in sorted(sample.labels.items())): sample.value
        for family in text_string_to_metric_families(exposition.decode())
        for sample in family.samples
    }


def scraped(metrics: Metrics) -> dict[str, float]:
    return samples(metrics.exposition()[0])


def a_pool(**changed: object) -> PoolState:
    state: dict[str, object] = {
        "permits": 16.0,
        "permits_taken": 2.5,
        "queued": 3,
        "running": 1,
        "workers": {"ready": 1},
        "pids": (os.getpid(),),
    }
    return PoolState(**{**state, **changed})  # type: ignore[arg-type]


def test_requests_are_counted_by_route_method_and_status() -> None:
    metrics = Metrics()
    metrics.observe_request("/label", "POST", 200, 0.07)
    metrics.observe_request("/label", "POST", 200, 0.08)
    metrics.observe_request("/label", "POST", 422, 0.001)

    found = scraped(metrics)

    assert found["boxlift_requests_total method=POST route=/label status=200"] == 2
    assert found["boxlift_requests_total method=POST route=/label status=422"] == 1


@pytest.mark.parametrize(
    ("status", "counted"), [(200, 1), (499, 1), (500, 1), (504, 1), (401, 0), (422, 0), (429, 0)]
)
def test_durations_leave_refusals_out(status: int, counted: int) -> None:
    metrics = Metrics()
    metrics.observe_request("/label", "POST", status, 0.07)

    found = scraped(metrics)

    assert found.get("boxlift_request_seconds_count route=/label", 0) == counted
    assert found.get("boxlift_request_seconds_bucket le=0.1 route=/label", 0) == counted
    assert found.get("boxlift_request_seconds_bucket le=0.05 route=/label", 0) == 0


def test_stages_results_refusals_drops_and_restarts_are_told() -> None:
    metrics = Metrics()
    metrics.observe_stages("/label", {"decode": 0.5, "fit": 1.5})
    metrics.observe_stages("/label", {"fit": 0.5})
    metrics.count_results("/label", {"FITTED": 4, "TOO_FEW_POINTS": 1})
    metrics.count_refused("label", "held_bytes")
    metrics.count_dropped("detect", "client_gone")
    metrics.count_restart("label", "died")

    found = scraped(metrics)

    assert found["boxlift_stage_seconds_sum route=/label stage=fit"] == 2.0
    assert found["boxlift_stage_seconds_count route=/label stage=decode"] == 1
    assert found["boxlift_results_total result=FITTED route=/label"] == 4
    assert found["boxlift_results_total result=TOO_FEW_POINTS route=/label"] == 1
    assert found["boxlift_refused_total pool=label reason=held_bytes"] == 1
    assert found["boxlift_dropped_total pool=detect reason=client_gone"] == 1
    assert found["boxlift_worker_restarts_total pool=label reason=died"] == 1


def test_a_pool_is_read_by_every_scrape() -> None:
    metrics = Metrics()
    states = iter([a_pool(), a_pool(permits_taken=7.0, queued=0, workers={"ready": 2, "failed": 1})])
    metrics.watch_pool("label", lambda: next(states))

    first, second = scraped(metrics), scraped(metrics)

    assert first["boxlift_permits pool=label"] == 16
    assert first["boxlift_permits_taken pool=label"] == 2.5
    assert first["boxlift_queue_requests pool=label"] == 3
    assert first["boxlift_running_requests pool=label"] == 1
    assert first["boxlift_workers pool=label state=ready"] == 1
    assert first["boxlift_workers pool=label state=starting"] == 0
    assert second["boxlift_permits_taken pool=label"] == 7
    assert second["boxlift_workers pool=label state=failed"] == 1


def test_series_begin_with_zero() -> None:
    # A series that appears with its first count is no increase to Prometheus.
    metrics = Metrics()
    metrics.watch_pool("detect", a_pool)

    found = scraped(metrics)

    assert found["boxlift_refused_total pool=http reason=rate"] == 0
    assert found["boxlift_refused_total pool=detect reason=too_busy"] == 0
    assert found["boxlift_dropped_total pool=detect reason=deadline"] == 0
    assert found["boxlift_worker_restarts_total pool=detect reason=silent"] == 0


@needs_proc
def test_resident_sets_of_workers_are_read() -> None:
    metrics = Metrics()
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as ended:
        pass
    metrics.watch_pool("label", lambda: a_pool(pids=(os.getpid(), ended.pid)))

    found = scraped(metrics)

    # As the kernel tells it elsewhere, give or take what this test took meanwhile.
    status = Path("/proc/self/status").read_text().split("VmRSS:")[1]
    expected = 1024 * int(status.split()[0])
    assert found["boxlift_worker_resident_bytes pool=label worker=0"] == pytest.approx(expected, rel=0.2)
    assert "boxlift_worker_resident_bytes pool=label worker=1" not in found
    assert resident_bytes(ended.pid) is None


def test_what_cannot_be_read_is_left_out(caplog: pytest.LogCaptureFixture) -> None:
    def broken() -> PoolState:
        raise RuntimeError("no state")

    metrics = Metrics()
    metrics.watch_pool("detect", broken)
    metrics.watch_pool("label", a_pool)
    metrics.watch("boxlift_held_bytes", "Bytes of bodies.", lambda: 1 / 0)
    metrics.watch("boxlift_connections", "Open connections.", lambda: 12)

    found = scraped(metrics)

    assert found["boxlift_permits pool=label"] == 16
    assert found["boxlift_connections"] == 12
    assert "boxlift_permits pool=detect" not in found
    assert "boxlift_held_bytes" not in found
    assert [record.getMessage() for record in caplog.records] == [
        "the state of pool detect cannot be read",
        "boxlift_held_bytes cannot be read",
    ]


def test_version_and_process_are_told_and_no_series_twice() -> None:
    metrics = Metrics()
    metrics.observe_request("/label", "POST", 200, 0.1)

    found = scraped(metrics)

    assert found[f"boxlift_build_info version={boxlift.__version__}"] == 1
    assert not [name for name in found if name.partition(" ")[0].endswith("_created")]
    if Path("/proc/self/statm").exists():
        assert found["process_resident_memory_bytes"] > 0


def test_two_services_of_one_process_count_apart() -> None:
    one, other = Metrics(), Metrics()
    one.count_refused("label", "too_busy")

    assert "boxlift_refused_total pool=label reason=too_busy" not in scraped(other)


def test_metrics_are_served() -> None:
    metrics = Metrics()
    metrics.watch("boxlift_connections", "Open connections.", lambda: 1)
    app = FastAPI()
    app.include_router(metrics_routes(metrics))

    with served(app) as server:
        response = httpx.get(f"{server.url}/metrics")

    assert response.status_code == 200
    assert response.headers["content-type"] == "text/plain; version=0.0.4; charset=utf-8"
    assert samples(response.content)["boxlift_connections"] == 1


def test_service_tells_what_it_did(service: RunningService, frame: SmallFrame) -> None:
    def told() -> dict[str, float]:
        return samples(service.client.get("/metrics").content)

    def increase(name: str) -> float:
        return after.get(name, 0) - before.get(name, 0)

    before = told()
    assert service.label(frame.fields()).status_code == 200
    assert service.client.post("/v1/label", files=list(frame.fields().items())).status_code == 200
    assert service.label(frame.fields(calib=b"nonsense")).status_code == 422
    after = told()

    assert increase("boxlift_requests_total method=POST route=/label status=200") == 2
    assert increase("boxlift_requests_total method=POST route=/label status=422") == 1
    assert increase("boxlift_request_seconds_count route=/label") == 2
    for stage in ("queue", "decode", "ground", "fit", "encode"):
        assert increase(f"boxlift_stage_seconds_count route=/label stage={stage}") == 2
    assert increase("boxlift_results_total result=FITTED route=/label") == 2
    for pool in ("label", "detect"):
        assert after[f"boxlift_workers pool={pool} state=ready"] == 1
        assert after[f"boxlift_permits pool={pool}"] > after[f"boxlift_permits_taken pool={pool}"] == 0
        assert after[f"boxlift_queue_requests pool={pool}"] == 0
    assert after["boxlift_connections"] >= 1
    assert after["boxlift_held_bytes"] == 0


@needs_proc
def test_service_tells_the_size_of_its_workers(service: RunningService) -> None:
    found = samples(service.client.get("/metrics").content)

    for pool in ("label", "detect"):
        assert found[f"boxlift_worker_resident_bytes pool={pool} worker=0"] > 20e6
    assert found["process_resident_memory_bytes"] > 20e6


def test_paths_of_the_service_are_the_same_few_labels(service: RunningService) -> None:
    for path in ("/openapi.json", "/v1/models", "/label/", "/v1/nothing"):
        service.client.get(path)

    found = samples(service.client.get("/metrics").content)

    routes = {name.split("route=")[1].split(" ")[0] for name in found if name.startswith("boxlift_requests")}
    assert {"/openapi.json", "/models", "other"} <= routes
    assert not [route for route in routes if route.startswith("/v1") or route == "/label/"]
