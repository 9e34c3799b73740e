"""What happens to the process that finds objects, happens to it alone."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from boxlift.detector import DEFAULT_FILE
from boxlift.errors import MissingExtraError, ModelFileError
from boxlift.settings import PRESETS
from boxlift_service import ServiceSettings
from boxlift_service.app import create_app
from boxlift_service.detection.models import open_models
from boxlift_service.workers.process import WorkerProcess
from model.detector.detector_files import detector_file
from model.stand_in_model import METADATA, stand_in_model
from service.frames import SmallFrame, calib_json, detect_parts, grey_png
from service.running import RunningService, running_service, wait_until_ready
from service.test_bad_input import assert_problem
from service.worker_jobs import modules


@pytest.fixture(scope="module")
def own_model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model that fails on white images."""
    return stand_in_model(tmp_path_factory.mktemp("own") / "own.onnx", brightest=250)


@pytest.fixture(scope="module")
def own(own_model: Path) -> Iterator[RunningService]:
    """A service whose processes may be hurt."""
    with running_service(model=str(own_model), silence_s="60") as running:
        yield running


def wait_for(what: Callable[[], bool]) -> None:
    end = time.monotonic() + 60
    while not what():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_work_that_a_worker_had_not_begun_is_done_by_the_next(own: RunningService, frame: SmallFrame) -> None:
    (worker,) = own.workers("detect")
    os.kill(worker, signal.SIGSTOP)  # so that it certainly does not begin
    with ThreadPoolExecutor(2) as pool:
        answers = [pool.submit(own.detect, detect_parts(grey_png())) for _ in range(2)]
        time.sleep(0.5)
        labelled = own.label(frame.fields())
        assert labelled.json()["objects"][0]["result"] == "FITTED"
        assert not any(answer.done() for answer in answers)
        os.kill(worker, signal.SIGKILL)
        assert [answer.result().status_code for answer in answers] == [200, 200]
    assert own.label(frame.fields()).status_code == 200
    assert worker not in own.workers("detect")


def test_a_request_that_its_worker_died_with_is_told_so(own: RunningService) -> None:
    calib = calib_json(image_size=[4000, 4000])
    many = detect_parts(*[grey_png(width=4000, height=4000)] * 16, calib=calib)
    with ThreadPoolExecutor(2) as pool:
        lost = pool.submit(own.detect, many)
        running = 'boxlift_running_requests{pool="detect"} 1.0'
        wait_for(lambda: running in own.client.get("/metrics").text)
        time.sleep(0.2)
        waiting = pool.submit(own.detect, detect_parts(grey_png()))
        os.kill(own.workers("detect")[0], signal.SIGKILL)
        assert_problem(lost.result(), 500, None, "ended by SIGKILL")
        assert lost.result().json()["type"] == "urn:boxlift:problem:worker-died"
        assert waiting.result().status_code == 200  # it waited its turn, and lost nothing


def test_a_worker_that_dies_idle_is_replaced_before_anybody_asks(own: RunningService) -> None:
    (worker,) = own.workers("detect")
    os.kill(worker, signal.SIGKILL)
    wait_for(lambda: own.workers("detect") not in ([], [worker]))
    wait_until_ready(own.client)
    assert own.detect(detect_parts(grey_png())).status_code == 200


def test_a_model_that_fails_on_an_image_is_no_fault_of_the_request(own: RunningService) -> None:
    workers = own.workers("detect")
    assert_problem(
        own.detect(detect_parts(grey_png(255))), 500, None, "the model fails on image (360, 1200, 3)"
    )
    assert own.detect(detect_parts(grey_png(200))).status_code == 200
    assert own.workers("detect") == workers


def test_signals_of_the_group_leave_the_worker_to_its_parent(own: RunningService) -> None:
    (worker,) = own.workers("detect")
    for number in (signal.SIGTERM, signal.SIGINT):
        os.kill(worker, number)
    assert own.detect(detect_parts(grey_png())).status_code == 200
    assert own.workers("detect") == [worker]


def test_a_model_file_that_breaks_later(own: RunningService, own_model: Path, frame: SmallFrame) -> None:
    whole = own_model.read_bytes()
    own_model.write_bytes(b"broken")
    (worker,) = own.workers("detect")
    os.kill(worker, signal.SIGKILL)
    wait_for(lambda: own.client.get("/models").json()["monocular"] is None)
    assert_problem(own.detect(detect_parts(grey_png())), 503, None, "There is no monocular model")
    assert "ONNX Runtime cannot load it" in own.client.get("/models").json()["missing"]["monocular"]
    assert own.label(frame.fields()).status_code == 200
    own_model.write_bytes(whole)
    (worker,) = own.workers("detect")
    os.kill(worker, signal.SIGKILL)
    wait_for(lambda: own.client.get("/models").json()["monocular"] is not None)
    wait_until_ready(own.client)
    assert own.detect(detect_parts(grey_png())).status_code == 200


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGINT, signal.SIGKILL])
def test_the_worker_ends_with_the_service(model_path: Path, how: signal.Signals) -> None:
    with running_service(model=str(model_path)) as service:
        (worker,) = service.workers("detect")
        service.process.send_signal(how)
        service.process.wait(30)

        def is_gone() -> bool:
            status = Path(f"/proc/{worker}/stat")
            return not status.exists() or status.read_text().rpartition(")")[2].split()[0] == "Z"

        wait_for(is_gone)


def test_torch_is_not_in_the_process_with_onnx_runtime(model_path: Path) -> None:
    worker = WorkerProcess(open_models, (ServiceSettings(model=model_path), PRESETS), 60)
    worker.start()
    try:
        loaded = worker.call(modules)
    finally:
        worker.stop()
    assert "onnxruntime" in loaded
    assert not {"torch", "open3d", "fastapi", "uvicorn"} & set(loaded)


def truncated(path: Path) -> None:
    path.write_bytes(stand_in_model(path).read_bytes()[:-500])


def white_is_too_much(path: Path) -> None:
    stand_in_model(path, brightest=10)  # it fails on the grey image that it is tried with


BROKEN_FILES: dict[str, tuple[Callable[[Path], object], str]] = {
    "missing": (lambda path: path.unlink(missing_ok=True), "does not exist"),
    "directory": (lambda path: path.mkdir(), "is a directory"),
    "empty": (lambda path: path.write_bytes(b""), "is empty"),
    "text": (lambda path: path.write_text("hello"), "cannot load it"),
    "truncated": (truncated, "cannot load it"),
    "another ONNX": (lambda path: shutil.copy(DEFAULT_FILE, path), "no input 'image_P_cam'"),
    "another interface": (
        lambda path: stand_in_model(path, metadata={**METADATA, "boxlift_interface": "monocular/0"}),
        "'monocular/0', not 'monocular/1'",
    ),
    "fails at once": (white_is_too_much, "the model fails on image (375, 1242, 3)"),
}


@pytest.mark.parametrize(("break_", "says"), BROKEN_FILES.values(), ids=BROKEN_FILES)
def test_a_model_file_that_is_none_stops_the_start(
    tmp_path: Path, break_: Callable[[Path], object], says: str
) -> None:
    path = tmp_path / "broken.onnx"
    break_(path)
    with pytest.raises(ModelFileError) as caught:
        create_app(ServiceSettings(model=path))
    assert caught.value.field == "BOXLIFT_MODEL"
    assert str(path) in caught.value.problem
    assert says in caught.value.problem


def test_a_detector_file_that_is_none_stops_the_start(tmp_path: Path, model_path: Path) -> None:
    with pytest.raises(
        ModelFileError, match=r"BOXLIFT_DETECTOR: .*hand_made\.onnx: the model wants an input"
    ):
        create_app(ServiceSettings(detector=model_path))
    path = detector_file(tmp_path / "odd.onnx", [(1, 2, 3, 4)], [0.9], [5])
    with pytest.raises(ModelFileError, match=r"BOXLIFT_DETECTOR: .*odd\.onnx"):
        create_app(ServiceSettings(detector=path))


def test_the_command_says_so_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("no model")
    ran = subprocess.run(
        [sys.executable, "-m", "boxlift_service"],
        env={**os.environ, "BOXLIFT_PORT": "0", "BOXLIFT_MODEL": str(tmp_path / "notes.txt")},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert ran.returncode == 1
    assert ran.stderr.startswith(
        f"error: BOXLIFT_MODEL: {tmp_path / 'notes.txt'}: ONNX Runtime cannot load it"
    )
    assert ran.stderr.count("\n") == 1


@pytest.fixture
def without_onnxruntime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Python processes that find no onnxruntime, as where the extra is not installed."""
    (tmp_path / "sitecustomize.py").write_text("import sys\nsys.modules['onnxruntime'] = None\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))


@pytest.mark.usefixtures("without_onnxruntime")
def test_without_onnx_runtime_the_service_labels(frame: SmallFrame, model_path: Path) -> None:
    with running_service() as service:
        assert service.label(frame.fields()).json()["objects"][0]["result"] == "FITTED"
        for answer in (
            service.detect(detect_parts(grey_png())),
            service.label(frame.fields(prompts=None, image=grey_png())),
        ):
            assert_problem(answer, 503, None, "pip install 'boxlift[detect]'")
            assert answer.json()["type"] == "urn:boxlift:problem:no-detector"
        answer = service.client.get("/models").json()
        assert answer["detector"] is answer["monocular"] is None
        assert set(answer["missing"]) == {"detector", "monocular"}
    with pytest.raises(MissingExtraError, match="onnxruntime"):
        create_app(ServiceSettings(model=model_path))
