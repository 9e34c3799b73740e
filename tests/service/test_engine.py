from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from boxlift_service import engine as engine_module
from boxlift_service.engine import Engine
from boxlift_service.problems import Kind, ProblemError
from boxlift_service.settings import ServiceSettings


@asynccontextmanager
async def started(settings: ServiceSettings) -> AsyncIterator[Engine]:
    engine = Engine(settings)
    engine.start()
    try:
        yield engine
    finally:
        engine.stop()


def test_work_runs_in_the_worker_with_the_threads_that_were_set() -> None:
    import torch

    async def scenario() -> tuple[str, int]:
        async with started(ServiceSettings(label_threads=2)) as engine:
            return await engine.run(lambda: (threading.current_thread().name, torch.get_num_threads()))

    thread, torch_threads = asyncio.run(scenario())
    assert thread.startswith("boxlift-worker")
    assert torch_threads == 2


def test_an_error_of_the_work_reaches_the_request_and_the_worker_lives() -> None:
    def fail() -> None:
        raise ValueError("of the work")

    async def scenario() -> int:
        async with started(ServiceSettings()) as engine:
            with pytest.raises(ValueError, match="of the work"):
                await engine.run(fail)
            return await engine.run(lambda: 7)

    assert asyncio.run(scenario()) == 7


def test_a_failed_warm_up_is_told_and_nothing_else_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken_installation() -> None:
        raise ImportError("libGL.so.1 is missing")

    monkeypatch.setattr(engine_module, "warm_up", broken_installation)

    async def scenario() -> ProblemError:
        async with started(ServiceSettings()) as engine:
            with pytest.raises(ProblemError) as caught:
                await engine.run(lambda: pytest.fail("must not run"))
            return caught.value

    problem = asyncio.run(scenario())
    assert problem.kind is Kind.NOT_READY
    assert "libGL.so.1" in problem.problem
