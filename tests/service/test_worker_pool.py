from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from boxlift.errors import OptionsError
from boxlift_service.problems import Kind, ProblemError
from boxlift_service.telemetry.metrics import Metrics
from boxlift_service.workers.deadline import Deadline
from boxlift_service.workers.permits import Permits
from boxlift_service.workers.place import Staff
from boxlift_service.workers.pool import WorkerPool
from boxlift_service.workers.process import WorkerDiedError, WorkerProcess
from service.worker_jobs import (
    Count,
    Nap,
    crash,
    hang,
    kill_itself,
    lacks_a_library,
    open_counter,
    open_if_there,
    opens_three_times,
    read_file,
    refuse,
    wrong_input,
)


@asynccontextmanager
async def started(
    count: int = 1,
    opener: Callable[..., Any] = open_counter,
    arguments: tuple[Any, ...] = (10,),
    *,
    limit_s: float = 60.0,
    silence_s: float = 60.0,
    metrics: Metrics | None = None,
) -> AsyncIterator[WorkerPool]:
    staff = Staff("test", lambda: WorkerProcess(opener, arguments, limit_s), silence_s)
    pool = WorkerPool(staff, count, Permits(16.0), metrics or Metrics())
    pool.start()
    try:
        yield pool
    finally:
        await pool.stop()
    assert not any(Path(f"/proc/{pid}").exists() for pid in pool.state().pids if pid)


async def until(what: Callable[[], bool]) -> None:
    async with asyncio.timeout(60):
        while not what():
            await asyncio.sleep(0.02)


def ready(pool: WorkerPool) -> bool:
    try:
        pool.require_ready()
    except ProblemError:
        return False
    return True


def count_of(metrics: Metrics, series: str) -> float:
    lines = metrics.exposition()[0].decode().splitlines()
    (value,) = [line.rpartition(" ")[2] for line in lines if line.startswith(series + " ")]
    return float(value)


def test_work_waits_for_the_workers_and_is_done_by_all_of_them() -> None:
    async def scenario() -> None:
        async with started(2) as pool:
            assert not ready(pool)
            answers = await asyncio.gather(*(pool.run(Nap(0.2)) for _ in range(6)))
            assert ready(pool)
            assert len({pid for pid, _ in answers}) == 2
            assert {pid for pid, _ in answers} == set(pool.state().pids)
            with pytest.raises(OptionsError, match="10 is enough"):
                await pool.run(wrong_input)
            assert (pool.state().queued, pool.state().running) == (0, 0)

    asyncio.run(scenario())


def test_work_gets_the_descriptor_which_is_closed_afterwards(tmp_path: Path) -> None:
    (tmp_path / "data").write_bytes(b"shared")

    async def scenario() -> None:
        async with started() as pool:
            file = os.open(tmp_path / "data", os.O_RDONLY)
            assert (await pool.run(read_file, file))[0] == b"shared"
            with pytest.raises(OSError, match="Bad file descriptor"):
                os.fstat(file)

    asyncio.run(scenario())


def test_only_the_request_of_a_worker_that_dies_is_lost() -> None:
    metrics = Metrics()

    async def scenario() -> None:
        async with started(metrics=metrics) as pool:
            lost, *others = (pool.run(work) for work in (kill_itself, Count(1), Count(1)))
            results = await asyncio.gather(lost, *others, return_exceptions=True)
            assert isinstance(results[0], ProblemError)
            assert results[0].kind is Kind.WORKER_DIED
            assert "ended by SIGKILL" in results[0].problem
            # The new worker began to count anew.
            assert [answer[1] for answer, _ in results[1:]] == [11, 12]  # type: ignore[misc]
            assert ready(pool)

    asyncio.run(scenario())
    assert count_of(metrics, 'boxlift_worker_restarts_total{pool="test",reason="died"}') == 1


def test_a_worker_that_is_killed_while_idle_costs_no_request() -> None:
    async def scenario() -> None:
        async with started() as pool:
            pid, _ = (await pool.run(Count(1)))[0]
            os.kill(pid, signal.SIGKILL)
            other, _ = (await pool.run(Count(1)))[0]
            assert other != pid

    asyncio.run(scenario())


@pytest.mark.parametrize(
    ("limit_s", "silence_s", "stops", "says", "reason"),
    [
        (3.0, 60.0, False, "no answer within 3 s", "late"),
        (60.0, 1.0, True, "not heard from for 1 s", "silent"),
    ],
)
def test_a_worker_that_hangs_or_is_stopped_is_replaced(
    limit_s: float, silence_s: float, stops: bool, says: str, reason: str
) -> None:
    metrics = Metrics()

    async def scenario() -> None:
        async with started(limit_s=limit_s, silence_s=silence_s, metrics=metrics) as pool:
            pid, _ = (await pool.run(Count(0)))[0]
            lost = asyncio.create_task(pool.run(hang))
            await until(lambda: pool.state().running == 1)
            if stops:
                os.kill(pid, signal.SIGSTOP)
            with pytest.raises(ProblemError, match="WORKER_DIED") as caught:
                await lost
            assert says in caught.value.problem
            assert (await pool.run(Count(0)))[0][0] != pid

    asyncio.run(scenario())
    assert count_of(metrics, f'boxlift_worker_restarts_total{{pool="test",reason="{reason}"}}') == 1


def test_a_worker_that_is_stopped_while_idle_is_noticed() -> None:
    async def scenario() -> None:
        async with started(silence_s=1.0) as pool:
            pid, _ = (await pool.run(Count(0)))[0]
            os.kill(pid, signal.SIGSTOP)
            await until(lambda: not ready(pool))
            await until(lambda: ready(pool))
            assert (await pool.run(Count(0)))[0][0] != pid

    asyncio.run(scenario())


def test_work_whose_client_went_or_whose_deadline_passed_is_dropped_and_counted() -> None:
    metrics = Metrics()

    async def scenario() -> None:
        async with started(metrics=metrics) as pool:
            await pool.run(Count(0))
            running = asyncio.create_task(pool.run(Nap(1.0)))
            await until(lambda: pool.state().running == 1)
            gone = asyncio.create_task(pool.run(Count(100)))
            with pytest.raises(ProblemError) as caught:
                await pool.run(Count(100), deadline=Deadline(0.2))
            assert caught.value.kind is Kind.DEADLINE_EXCEEDED
            gone.cancel()
            await asyncio.wait((gone,))
            assert pool.state().queued == 0
            await running
            assert (await pool.run(Count(0)))[0][1] == 10  # nobody counted 100 more

    asyncio.run(scenario())
    for reason in ("client_gone", "deadline"):
        assert count_of(metrics, f'boxlift_dropped_total{{pool="test",reason="{reason}"}}') == 1


def test_a_deadline_that_passes_while_work_is_done_answers_at_once_and_keeps_the_worker() -> None:
    async def scenario() -> None:
        async with started() as pool:
            pid, _ = (await pool.run(Count(0)))[0]
            with pytest.raises(ProblemError, match="DEADLINE_EXCEEDED"):
                await pool.run(Nap(0.6), deadline=Deadline(0.1))
            assert (await pool.run(Count(0)))[0][0] == pid

    asyncio.run(scenario())


@pytest.mark.parametrize(
    ("opener", "says"),
    [
        (refuse, "it is wrong"),
        (crash, "it ended with status 7"),
        (lacks_a_library, "libGL.so.1 is missing"),
    ],
    ids=["refuses", "crashes", "lacks a library"],
)
def test_where_no_worker_can_start_requests_are_told_why(opener: Callable[[], Any], says: str) -> None:
    async def scenario() -> None:
        async with started(2, opener, ()) as pool:
            with pytest.raises(ProblemError) as caught:
                await pool.run(Count(0))
            assert caught.value.kind is Kind.NOT_READY
            assert says in caught.value.problem
            with pytest.raises(ProblemError, match="NOT_READY"):
                await pool.run(Count(0))
            assert not ready(pool)

    asyncio.run(scenario())


def test_a_worker_that_could_not_start_is_tried_again(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with started(1, open_if_there, (tmp_path / "file",)) as pool:
            with pytest.raises(ProblemError, match="NOT_READY"):
                await pool.run(Count(0))
            (tmp_path / "file").write_text("7")
            await until(lambda: ready(pool))
            assert (await pool.run(Count(0)))[0][1] == 7

    asyncio.run(scenario())


def test_renewal_loses_no_request_and_takes_what_is_there_now(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("7")

    async def scenario() -> None:
        async with started(2, open_if_there, (tmp_path / "file",)) as pool:
            before = {(await pool.run(Nap(0.1)))[0] for _ in range(4)}
            (tmp_path / "file").write_text("8")
            asked = [asyncio.create_task(pool.run(Nap(0.05))) for _ in range(40)]
            await pool.renew(Count(0))
            assert before.isdisjoint(pool.state().pids)
            assert len(await asyncio.gather(*asked)) == 40
            assert (await pool.run(Count(0)))[0][1] == 8
            assert ready(pool)

    asyncio.run(scenario())


def test_renewal_that_meets_a_worker_that_dies_leaves_a_place_that_works() -> None:
    async def scenario() -> None:
        async with started(limit_s=1.0) as pool:
            for _ in range(3):
                pid, _ = (await pool.run(Count(0)))[0]
                lost = asyncio.create_task(pool.run(hang))
                await until(lambda: pool.state().running == 1)
                await pool.renew(Count(0))  # the new one waits until that is over
                assert lost.done()
                with pytest.raises(ProblemError, match="WORKER_DIED"):
                    await lost
                await until(lambda: ready(pool))
                assert (await pool.run(Count(0)))[0][0] != pid
                await asyncio.sleep(0.3)
                assert ready(pool)

    asyncio.run(scenario())


def test_a_worker_that_cannot_start_for_any_reason_is_tried_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    start = WorkerProcess.start
    failures: list[RuntimeError] = []

    def start_or_fail(process: WorkerProcess[Any]) -> None:
        if failures:
            raise failures.pop()
        start(process)

    async def scenario() -> None:
        async with started() as pool:
            pid, _ = (await pool.run(Count(0)))[0]
            failures.append(RuntimeError("can't start new thread"))
            os.kill(pid, signal.SIGKILL)
            await until(lambda: not failures)
            await until(lambda: ready(pool))
            assert (await pool.run(Count(0)))[0][0] != pid

    monkeypatch.setattr(WorkerProcess, "start", start_or_fail)
    asyncio.run(scenario())


def test_work_whose_deadline_has_passed_is_not_begun() -> None:
    metrics = Metrics()

    async def scenario() -> None:
        async with started(metrics=metrics) as pool:
            with pytest.raises(ProblemError, match="DEADLINE_EXCEEDED"):
                async with pool.permitted(1.0, deadline=Deadline(-1.0)):
                    pytest.fail("it is too late")
            assert pool.permits.taken == 0

    asyncio.run(scenario())
    assert count_of(metrics, 'boxlift_dropped_total{pool="test",reason="deadline"}') == 1


def test_renewal_of_which_a_later_process_fails_changes_none(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with started(2, opens_three_times, (tmp_path / "opened",)) as pool:
            await asyncio.gather(*(pool.run(Nap(0.1)) for _ in range(4)))
            before = pool.state().pids
            with pytest.raises(OptionsError, match="three times"):
                await pool.renew(Count(0))
            assert pool.state().pids == before
            assert ready(pool)

    asyncio.run(scenario())


def test_renewal_that_fails_leaves_the_workers_that_are_there(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("7")

    async def scenario() -> None:
        async with started(1, open_if_there, (tmp_path / "file",)) as pool:
            pid, _ = (await pool.run(Count(0)))[0]
            with pytest.raises(WorkerDiedError):
                await pool.renew(kill_itself)
            (tmp_path / "file").unlink()
            with pytest.raises(OptionsError):
                await pool.renew(Count(0))
            assert (await pool.run(Count(0)))[0] == (pid, 7)
            assert ready(pool)

    asyncio.run(scenario())
