"""What operators and busy clients meet: refusals, deadlines, slow bodies, reloads, and a gentle end."""

from __future__ import annotations

import hashlib
import os
import signal
import socket
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Literal
from urllib.parse import urlsplit

import httpx
import pytest

from model.stand_in_model import stand_in_model
from service.frames import SmallFrame, detect_parts, grey_png
from service.running import RunningService, running_service, wait_until_ready
from service.test_bad_input import assert_problem


@pytest.fixture(scope="module")
def own_model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model whose file may be changed."""
    return stand_in_model(tmp_path_factory.mktemp("own") / "own.onnx")


@pytest.fixture(scope="module")
def busy(own_model: Path) -> Iterator[RunningService]:
    """A service with room for two frames at a time, that is impatient, and whose workers may be hurt."""
    limits = {"permits_per_worker": "0.5", "receive_idle_s": "1", "linger_s": "1", "silence_s": "60"}
    with running_service(model=str(own_model), **limits) as running:
        yield running


def metric(service: RunningService, series: str) -> float:
    lines = service.client.get("/metrics").text.splitlines()
    return sum(float(line.rpartition(" ")[2]) for line in lines if line.startswith(series + " "))


def wait_for_metric(service: RunningService, series: str, value: float) -> None:
    end = time.monotonic() + 30
    while (found := metric(service, series)) != value:
        assert time.monotonic() < end, found
        time.sleep(0.05)


def connected(service: RunningService) -> socket.socket:
    address = urlsplit(service.url)
    return socket.create_connection((address.hostname, address.port), timeout=30)


class Stopped:
    """The label worker stopped, so that work waits, while the body of a `with` runs."""

    def __init__(self, service: RunningService) -> None:
        (self._worker,) = service.workers("label")

    def __enter__(self) -> None:
        os.kill(self._worker, signal.SIGSTOP)

    def __exit__(self, *_: object) -> None:
        os.kill(self._worker, signal.SIGCONT)


def test_every_route_is_under_v1_too(busy: RunningService, frame: SmallFrame) -> None:
    assert busy.client.get("/v1/healthz").json() == {"status": "alive"}
    assert busy.client.get("/v1/models").json() == busy.client.get("/models").json()
    answers = [busy.client.post(path, files=list(frame.fields().items())) for path in ("/label", "/v1/label")]
    assert answers[0].json() == answers[1].json()


def test_what_computes_is_not_even_loaded_in_the_server(busy: RunningService) -> None:
    def libraries(pid: int) -> set[str]:
        maps = Path(f"/proc/{pid}/maps").read_text()
        return {name for name in ("libtorch_cpu", "open3d", "onnxruntime") if name in maps}

    assert libraries(busy.process.pid) == set()
    assert libraries(busy.workers("label")[0]) == {"libtorch_cpu", "open3d"}
    assert libraries(busy.workers("detect")[0]) == {"onnxruntime"}


def test_work_beyond_the_permits_is_refused_and_what_was_taken_on_is_answered(
    busy: RunningService, frame: SmallFrame
) -> None:
    refused_before = metric(busy, 'boxlift_refused_total{pool="label",reason="too_busy"}')
    with ThreadPoolExecutor(2) as pool, Stopped(busy):
        accepted = [pool.submit(busy.label, frame.fields()) for _ in range(2)]
        wait_for_metric(busy, 'boxlift_permits_taken{pool="label"}', 0.5)
        refused = busy.label(frame.fields())
        assert_problem(refused, 429, None, "0.5 of 0.5 permits")
        assert int(refused.headers["retry-after"]) >= 1
        assert busy.detect(detect_parts(grey_png())).status_code == 200  # another pool has its own
        os.kill(busy.workers("label")[0], signal.SIGCONT)
        assert [answer.result().status_code for answer in accepted] == [200, 200]
    assert metric(busy, 'boxlift_refused_total{pool="label",reason="too_busy"}') == refused_before + 1
    assert busy.label(frame.fields()).status_code == 200
    assert metric(busy, 'boxlift_permits_taken{pool="label"}') == 0


def test_a_deadline_of_the_client_is_kept(busy: RunningService, frame: SmallFrame) -> None:
    files = list(frame.fields().items())
    with Stopped(busy):
        answer = busy.client.post("/label", files=files, headers={"X-Request-Timeout": "0.3"})
    assert_problem(answer, 504, None, "within the 0.3 s of X-Request-Timeout")
    for nonsense in ("soon", "-1", "nan", "1e9"):
        answer = busy.client.post("/label", files=files, headers={"X-Request-Timeout": nonsense})
        assert_problem(answer, 422, "X-Request-Timeout", nonsense)
    assert busy.client.post("/label", files=files, headers={"X-Request-Timeout": "60"}).status_code == 200


def test_work_of_a_client_that_went_away_is_dropped(busy: RunningService, frame: SmallFrame) -> None:
    dropped = 'boxlift_dropped_total{pool="label",reason="client_gone"}'
    before = metric(busy, dropped)
    with Stopped(busy), httpx.Client(base_url=busy.url, timeout=0.3) as impatient:
        with pytest.raises(httpx.ReadTimeout):
            impatient.post("/label", files=list(frame.fields().items()))
        wait_for_metric(busy, dropped, before + 1)
        wait_for_metric(busy, 'boxlift_permits_taken{pool="label"}', 0)
    assert metric(busy, "boxlift_held_bytes") == 0
    gone = 'boxlift_requests_total{method="POST",route="/label",status="499"}'
    assert metric(busy, gone) >= 1
    assert busy.label(frame.fields()).status_code == 200


def test_a_body_that_stops_is_refused_in_time_and_holds_nothing(busy: RunningService) -> None:
    head = (
        b"POST /label HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000000\r\n"
        b"Content-Type: multipart/form-data; boundary=line\r\n\r\n--line\r\n"
        b'Content-Disposition: form-data; name="points"\r\n\r\n' + bytes(50_000)
    )
    with connected(busy) as slow:
        slow.sendall(head)
        answer = b"".join(iter(lambda: slow.recv(65_536), b""))
        assert answer.startswith(b"HTTP/1.1 408 ")
        assert b"The body stopped after 500" in answer
    wait_for_metric(busy, "boxlift_held_bytes", 0)


def test_bodies_together_may_not_hold_more_than_the_limit(frame: SmallFrame) -> None:
    with running_service(max_held_bytes=str(2**20), max_body_bytes=str(2**21)) as service:
        large = frame.fields(points=bytes(2**20 + 16))
        assert_problem(service.label(large), 429, None, "1048576 bytes that are held")
        assert service.label(frame.fields()).status_code == 200
        assert metric(service, "boxlift_held_bytes") == 0


def reloaded(service: RunningService, digest: str) -> bool:
    return bool(service.client.get("/models").json()["monocular"]["digest"] == digest)


def test_models_are_reloaded_without_a_dropped_request(busy: RunningService, own_model: Path) -> None:
    files = detect_parts(grey_png())
    whole = own_model.read_bytes()
    for number, how in enumerate(("route", "signal")):
        stand_in_model(own_model, brightest=200 + number)
        digest = hashlib.sha256(own_model.read_bytes()).hexdigest()
        assert not reloaded(busy, digest)
        with ThreadPoolExecutor(1) as pool:
            answers = pool.submit(lambda: [busy.detect(files).status_code for _ in range(20)])
            if how == "route":
                answer = busy.client.post("/models:reload")
                assert answer.json()["monocular"]["digest"] == digest
            else:
                busy.process.send_signal(signal.SIGHUP)
                end = time.monotonic() + 30
                while not reloaded(busy, digest):
                    assert time.monotonic() < end
                    time.sleep(0.05)
            assert answers.result() == [200] * 20
        assert busy.detect(files).json()["model"]["digest"] == digest
    own_model.write_bytes(b"broken")
    assert_problem(busy.client.post("/models:reload"), 503, None, "those before are used on")
    assert busy.detect(files).json()["model"]["digest"] == digest
    assert busy.client.get("/readyz").status_code == 200
    own_model.write_bytes(whole)
    assert busy.client.post("/models:reload").status_code == 200


def test_reloads_that_are_asked_for_together_are_one_and_the_next(busy: RunningService) -> None:
    done = 'boxlift_worker_restarts_total{pool="detect",reason="reload"}'
    before = metric(busy, done)
    with ThreadPoolExecutor(8) as pool:
        answers = pool.map(lambda _: busy.client.post("/models:reload").status_code, range(8))
        assert list(answers) == [200] * 8
    assert 1 <= metric(busy, done) - before <= 4


def test_a_shutdown_drains_and_answers_what_was_accepted(frame: SmallFrame) -> None:
    with running_service(drain_s="2", silence_s="60") as service:
        (worker,) = service.workers("label")
        with ThreadPoolExecutor(1) as pool:
            os.kill(worker, signal.SIGSTOP)
            accepted = pool.submit(service.label, frame.fields())
            wait_for_metric(service, 'boxlift_permits_taken{pool="label"}', 0.25)
            service.process.send_signal(signal.SIGTERM)
            end = time.monotonic() + 10
            while (answer := service.client.get("/readyz")).status_code == 200:
                assert time.monotonic() < end
            assert_problem(answer, 503, None, "about to end")
            healthy = service.client.get("/healthz")
            assert healthy.status_code == 200
            assert healthy.headers["connection"] == "close"
            time.sleep(2.5)  # its port is closed by now
            with pytest.raises(httpx.ConnectError):
                httpx.get(f"{service.url}/healthz")
            os.kill(worker, signal.SIGCONT)
            assert accepted.result().json()["objects"][0]["result"] == "FITTED"
        assert service.process.wait(30) == -signal.SIGTERM  # as uvicorn ends: by the signal it was told to


def test_a_silent_worker_makes_the_service_unready_until_it_is_replaced(frame: SmallFrame) -> None:
    with running_service(silence_s="1.5") as service:
        pools: tuple[Literal["label", "detect"], ...] = ("label", "detect")
        for pool in pools:
            (worker,) = service.workers(pool)
            os.kill(worker, signal.SIGSTOP)
            end = time.monotonic() + 30
            while service.client.get("/readyz").status_code == 200:
                assert time.monotonic() < end
                time.sleep(0.01)
            wait_until_ready(service.client)
            assert service.workers(pool) != [worker]
            assert metric(service, f'boxlift_worker_restarts_total{{pool="{pool}",reason="silent"}}') == 1
        assert service.label(frame.fields()).status_code == 200
        assert service.detect(detect_parts(grey_png())).status_code == 200
