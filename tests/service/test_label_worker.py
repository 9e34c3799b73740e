from __future__ import annotations

from boxlift.settings import PRESETS
from boxlift_service import ServiceSettings
from boxlift_service.labelling.worker import LabelWorker, open_label_worker
from boxlift_service.workers.process import WorkerProcess
from service.worker_jobs import modules, torch_threads


def test_a_label_worker_has_the_threads_that_were_set_and_no_onnx_runtime() -> None:
    arguments = (ServiceSettings(label_threads=2), PRESETS)
    worker: WorkerProcess[LabelWorker] = WorkerProcess(
        open_label_worker, arguments, 60, method="forkserver", name="boxlift-label"
    )
    worker.start()
    try:
        assert worker.call(torch_threads) == 2
        loaded = worker.call(modules)
    finally:
        worker.stop()
    assert {"torch", "open3d"} <= set(loaded)
    assert not {"onnxruntime", "uvicorn"} & set(loaded)
