from __future__ import annotations

import asyncio

import pytest

from boxlift_service.problems import Kind, ProblemError
from boxlift_service.workers.permits import Permits


def test_work_beyond_the_permits_is_refused_until_some_are_back() -> None:
    async def scenario() -> None:
        permits = Permits(2.0)
        first = await permits.take(0.8)
        second = await permits.take(1.0)
        with pytest.raises(ProblemError) as caught:
            await permits.take(0.3)
        assert caught.value.kind is Kind.TOO_BUSY
        assert "1.8 of 2 permits" in caught.value.problem
        assert 1 <= int(caught.value.headers["Retry-After"]) <= 60
        permits.give_back(first)
        assert await permits.take(0.3) == 0.3
        permits.give_back(second)
        permits.give_back(0.3)
        assert permits.taken == 0

    asyncio.run(scenario())


def test_work_larger_than_all_permits_is_done_and_leaves_room_for_others() -> None:
    async def scenario() -> None:
        permits = Permits(16.0)
        large = await permits.take(2000.0)
        assert large == 8.0
        assert await permits.take(5.0) == 5.0
        assert not permits.exhausted
        permits.give_back(large)

    asyncio.run(scenario())


def test_who_waits_is_served_in_the_order_of_asking() -> None:
    async def scenario() -> list[int]:
        permits, served = Permits(1.0), []

        async def work(number: int) -> None:
            taken = await permits.take(0.5, wait=True)
            served.append(number)
            await asyncio.sleep(0)
            permits.give_back(taken)

        held = [await permits.take(0.5), await permits.take(0.5)]
        waiting = [asyncio.create_task(work(number)) for number in range(4)]
        await asyncio.sleep(0)
        waiting[1].cancel()
        for taken in held:
            permits.give_back(taken)
        await asyncio.gather(*waiting, return_exceptions=True)
        assert permits.taken == 0
        return served

    assert asyncio.run(scenario()) == [0, 2, 3]


def test_large_work_that_waits_is_not_overtaken_by_small_work_that_waits() -> None:
    async def scenario() -> None:
        permits = Permits(16.0)
        held = [await permits.take(4.0) for _ in range(3)]
        large = asyncio.create_task(permits.take(8.0, wait=True))
        await asyncio.sleep(0)
        small = [asyncio.create_task(permits.take(1.0, wait=True)) for _ in range(4)]
        await asyncio.sleep(0)
        assert not any(task.done() for task in (large, *small))  # although each of the small would fit
        assert await permits.take(1.0) == 1.0  # who does not wait goes before them
        permits.give_back(1.0)
        permits.give_back(held.pop())
        assert await large == 8.0
        assert not any(task.done() for task in small)
        permits.give_back(8.0)
        assert await asyncio.gather(*small) == [1.0] * 4

    asyncio.run(scenario())


def test_who_is_let_in_and_leaves_at_once_gives_back_what_was_taken() -> None:
    async def scenario() -> None:
        permits = Permits(2.0)
        held = [await permits.take(1.0), await permits.take(1.0)]
        leaving = asyncio.create_task(permits.take(1.0, wait=True))
        await asyncio.sleep(0)
        permits.give_back(held.pop())  # lets it in
        leaving.cancel()  # before it has noticed
        with pytest.raises(asyncio.CancelledError):
            await leaving
        assert permits.taken == 1.0

    asyncio.run(scenario())


def test_retry_after_follows_how_fast_the_work_before_was_done(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr("boxlift_service.workers.permits.monotonic", lambda: now)

    async def scenario() -> None:
        nonlocal now
        permits = Permits(16.0)
        for _ in range(50):  # a permit takes 4 s
            taken = await permits.take(1.0)
            now += 4.0
            permits.give_back(taken)
        await permits.take(6.0)
        assert permits.seconds_of_work() == 24
        await permits.take(8.0)
        await permits.take(2.0)
        assert permits.exhausted
        assert permits.seconds_of_work() == 60  # the longest that is told

    asyncio.run(scenario())
