"""What may happen to a service: its workers die or stop, clients vanish or dawdle, it is told to reload."""

from __future__ import annotations

import asyncio
import os
import random
import signal
from collections import Counter
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from serving.connection import Connection, LostError
from serving.load_loops import OK
from serving.processes import DETECT
from serving.stage import Account, Stage, answer_or_end


@dataclass(frozen=True)
class Extent:
    """How often each fault is made; drains_s: how long each service that is ended may drain."""

    kills: int = 20
    stops: int = 2
    vanishing: int = 100
    slow: int = 200
    reloads: int = 5
    drains_s: tuple[float, ...] = (0.0, 2.0, 5.0)
    frames: int = 3

    @classmethod
    def short(cls) -> Extent:
        """For a first impression."""
        return cls(kills=2, stops=1, vanishing=10, slow=20, reloads=1, drains_s=(2.0,), frames=1)


async def kill(stage: Stage, role: str, times: int) -> Account:
    """kill -9 of a worker under load, as often as told, at odd moments."""
    return await _signal_under_load(stage, f"kill -9, {role} worker", role, signal.SIGKILL, times)


async def stop_busy(stage: Stage, role: str, times: int) -> Account:
    """SIGSTOP of a worker under load."""
    return await _signal_under_load(stage, f"SIGSTOP, busy {role} worker", role, signal.SIGSTOP, times)


async def stop_idle(stage: Stage, role: str, times: int) -> Account:
    """SIGSTOP of a worker that has nothing to do; then a little load."""
    account = Account(f"SIGSTOP, idle {role} worker")
    await _strike_workers(stage, account, role, signal.SIGSTOP, times)
    account.may_die = 0  # they had no request

    async def nothing(_: Account) -> None:
        await asyncio.sleep(2.0)

    await stage.under_load(account, nothing)
    return account


async def _signal_under_load(
    stage: Stage, fault: str, role: str, number: signal.Signals, times: int
) -> Account:
    account = Account(fault)

    async def strike(_: Account) -> None:
        await _strike_workers(stage, account, role, number, times)

    await stage.under_load(account, strike)
    return account


async def _strike_workers(
    stage: Stage, account: Account, role: str, number: signal.Signals, times: int
) -> None:
    """Signal a worker, wait until it has been replaced, and again."""
    draw = random.Random(role)
    for _ in range(times):
        there = await stage.workers(role)
        if not there:
            account.wrong.append(f"there is no {role} worker")
            return
        victim = draw.choice(sorted(there))
        os.kill(victim, number)
        account.times += 1
        account.may_die += 1
        if not await stage.recovered(account, {role: ({victim}, len(there))}):
            return
        await asyncio.sleep(draw.uniform(0.1, 0.6))


async def vanish_in_upload(stage: Stage, times: int) -> Account:
    """Clients that end the connection, or reset it, with part of a body sent."""

    async def vanish(draw: random.Random) -> None:
        data = stage.request().data
        connection = await Connection.open(stage.service.url)
        connection.send(data[: draw.randrange(20, len(data) - 1)])
        await asyncio.sleep(draw.uniform(0, 0.3))
        _end(connection, draw)

    return await _vanish(stage, "client vanishes in upload", times, vanish)


async def vanish_in_answer(stage: Stage, times: int) -> Account:
    """Clients that end the connection, or reset it, while they wait for the answer or while it comes."""

    async def vanish(draw: random.Random) -> None:
        connection = await Connection.open(stage.service.url, receive_buffer=2048)
        connection.transport.pause_reading()
        connection.send(stage.request().data)
        await asyncio.sleep(draw.uniform(0.05, 3.0))
        _end(connection, draw)

    return await _vanish(stage, "client vanishes in answer", times, vanish)


async def _vanish(
    stage: Stage, fault: str, times: int, vanish: Callable[[random.Random], Awaitable[None]]
) -> Account:
    account = Account(fault, times)
    draw = random.Random(fault)

    async def strike(_: Account) -> None:
        for begin in range(0, times, 10):
            await asyncio.gather(*(vanish(draw) for _ in range(begin, min(begin + 10, times))))

    before = await _told_as_gone(stage)
    await stage.under_load(account, strike, connections=3)
    told = await _told_as_gone(stage) - before
    account.notes.append(
        f"counted with status 499: {told:.0f}; the others went before or after their request"
    )
    return account


async def _told_as_gone(stage: Stage) -> float:
    """Requests that the service has counted as left by their client."""
    metrics = await asyncio.to_thread(stage.service.metrics)
    return sum(
        value
        for series, value in metrics.items()
        if series.startswith("boxlift_requests_total") and 'status="499"' in series
    )


def _end(connection: Connection, draw: random.Random) -> None:
    if draw.random() < 0.5:
        connection.reset()
    else:
        connection.transport.abort()


async def slow_uploads(stage: Stage, how_many: int, end_s: float) -> Account:
    """Uploads at once that stop after a few bytes, or bring one now and then; each is to get a 408.

    end_s: when the service is to have ended all of them.
    """
    account = Account("slow uploads at once", how_many)
    ends: Counter[str] = Counter()

    async def dawdle(index: int) -> None:
        data = stage.request().data
        try:
            connection = await Connection.open(stage.service.url)
        except LostError as error:
            ends[str(error)] += 1
            return
        connection.send(data[:2000])
        dripping = asyncio.create_task(_drip(connection, data[2000:])) if index % 2 else None
        ends[await answer_or_end(connection, end_s + 10)] += 1
        if dripping:
            dripping.cancel()
        connection.close()

    async def strike(_: Account) -> None:
        await asyncio.gather(*(dawdle(index) for index in range(how_many)))

    await stage.under_load(account, strike, connections=3)
    account.notes.append(f"slow ones: {dict(ends)}")
    if ends != {"408": how_many}:
        account.wrong.append(f"slow uploads ended as {dict(ends)}, and not with 408")
    return account


async def _drip(connection: Connection, data: bytes) -> None:
    for byte in data:
        connection.send(bytes([byte]))
        await asyncio.sleep(0.5)


async def reload(stage: Stage, times: int) -> Account:
    """SIGHUP under load: the workers with the models are replaced; no request notices, nor does /readyz."""
    account = Account("SIGHUP: reload")

    async def strike(_: Account) -> None:
        for _turn in range(times):
            there = await stage.workers(DETECT)
            os.kill(stage.service.pid, signal.SIGHUP)
            account.times += 1
            if not await stage.recovered(account, {DETECT: (there, len(there))}, stays_ready=True):
                return

    await stage.under_load(account, strike)
    if account.recoveries_s:
        account.notes.append(f"replaced after {max(account.recoveries_s):.1f} s at most, ready all the time")
        account.recoveries_s.clear()
    if account.answers.total() != account.answers[OK]:
        account.wrong.append("not every request beside a reload was answered with 200")
    return account
