from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from boxlift.errors import OptionsError
from boxlift_service.workers.process import WorkerDiedError, WorkerFaultError, WorkerProcess
from service.worker_jobs import (
    Count,
    Echo,
    crash,
    fault,
    hang,
    kill_itself,
    open_counter,
    refuse,
    wrong_input,
)


@contextmanager
def started(deadline_s: float = 60.0) -> Iterator[WorkerProcess[list[int]]]:
    worker = WorkerProcess(open_counter, (10,), deadline_s)
    worker.start()
    try:
        yield worker
    finally:
        worker.stop()


def test_work_runs_there_on_the_state_that_was_opened() -> None:
    with started() as worker:
        pid, count = worker.call(Count(1))
        assert pid != os.getpid()
        assert count == 11
        assert worker.call(Count(5)) == (pid, 16)
        data = os.urandom(3_000_000)
        assert worker.call(Echo(data)) == data
        with pytest.raises(OptionsError, match="16 is enough"):
            worker.call(wrong_input)
        with pytest.raises(WorkerFaultError, match="ZeroDivisionError: at 16"):
            worker.call(fault)
        assert worker.call(Count(0)) == (pid, 16)
    assert worker.pid is None
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_a_worker_that_dies_says_how_and_can_be_replaced() -> None:
    with started() as worker:
        ended = threading.Event()
        worker.watch(ended.set)
        with pytest.raises(WorkerDiedError, match="ended by SIGKILL"):
            worker.call(kill_itself)
        assert ended.wait(10)
        assert worker.pid is None
        with pytest.raises(WorkerDiedError, match="has not been started"):
            worker.call(Count(1))
        worker.start()
        assert worker.call(Count(1))[1] == 11


def test_a_worker_that_hangs_is_ended() -> None:
    with started(deadline_s=5) as worker:
        pid, _ = worker.call(Count(0))
        start = time.monotonic()
        with pytest.raises(WorkerDiedError, match="no answer within 5 s"):
            worker.call(hang)
        assert time.monotonic() - start < 30
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_a_worker_that_does_not_even_read_is_ended() -> None:
    with started(deadline_s=5) as worker:
        pid, _ = worker.call(Count(0))
        os.kill(pid, signal.SIGSTOP)
        with pytest.raises(WorkerDiedError, match="no answer within 5 s"):
            worker.call(Echo(bytes(20_000_000)))
        assert worker.pid is None


def test_a_worker_that_hangs_ends_with_its_parent() -> None:
    code = (
        "import sys; from boxlift_service.workers.process import WorkerProcess; "
        "from service.worker_jobs import Count, hang, open_counter; "
        "worker = WorkerProcess(open_counter, (1,), 60); worker.start(); "
        "print(worker.call(Count(0))[0], flush=True); worker.call(hang)"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[1]
    ) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        time.sleep(0.5)  # it hangs by now
        parent.kill()
    end = time.monotonic() + 20
    while Path(f"/proc/{pid}").exists():
        assert time.monotonic() < end
        time.sleep(0.05)


@pytest.mark.parametrize(
    ("opener", "error", "says"),
    [(refuse, OptionsError, "it is wrong"), (crash, WorkerDiedError, "status 7")],
)
def test_an_opener_that_fails(opener: Callable[[], Any], error: type[Exception], says: str) -> None:
    worker: WorkerProcess[Any] = WorkerProcess(opener, (), 60)
    with pytest.raises(error, match=says):
        worker.start()
    assert worker.pid is None
