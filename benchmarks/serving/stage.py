"""A service under load while something is done to it, and the account of how it took that."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from serving import processes
from serving.connection import Connection, LostError, get
from serving.load_loops import HUNG, OK, REFUSED, Load, Run
from serving.prepared import Prepared, mixed
from serving.processes import Level
from serving.service_process import Service

DIED = "500 worker-died"

_RECOVERS_WITHIN_S = 10.0
_GIVEN_UP_AFTER_S = 40.0
_LOOKS_EVERY_S = 0.1


@dataclass
class Account:
    """How a service took a fault.

    times: how often it was struck. answers: how the requests beside it ended. may_die: how many of them may
    have been lost with a worker (500). recoveries_s: from each strike until it was ready as before.
    left: what it holds more than before the first fault. wrong: what was not as it is to be, as sentences.
    """

    fault: str
    times: int = 0
    answers: Counter[str] = field(default_factory=Counter)
    may_die: int = 0
    recoveries_s: list[float] = field(default_factory=list)
    left: dict[str, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)

    @property
    def server_errors(self) -> int:
        """Answers 5xx."""
        return sum(count for verdict, count in self.answers.items() if verdict.startswith("5"))

    @property
    def lost(self) -> int:
        """Requests with no answer, or with one that the service should not have given."""
        return self.answers.total() - self.answers[OK] - self.answers[REFUSED] - self.server_errors

    def judge(self) -> None:
        """Note what was not as it is to be."""
        died = self.answers[DIED]
        if died > self.may_die:
            self.wrong.append(f"{died} requests were lost with a worker, {self.may_die} may be")
        allowed = {OK, REFUSED, DIED}
        self.wrong += [f"{count} x {what}" for what, count in self.answers.items() if what not in allowed]
        if self.recoveries_s and max(self.recoveries_s) > _RECOVERS_WITHIN_S:
            self.wrong.append(f"a recovery took {max(self.recoveries_s):.1f} s")
        if self.left:
            self.wrong.append(f"left behind: {self.left}")

    def told(self) -> dict[str, Any]:
        """For the JSON file."""
        return {**vars(self), "answers": dict(self.answers), "lost": self.lost}


class Stage:
    """One service, requests to it, and the level of what it held before the first fault."""

    def __init__(self, service: Service, made: Mapping[str, Sequence[Prepared]]) -> None:
        self.service = service
        self.made = made
        self._requests = mixed(made, seed=5)
        self._level: Level | None = None

    def request(self) -> Prepared:
        """The next one of the mix."""
        return next(self._requests)

    async def warm_up(self, seconds: float) -> None:
        """Load, so that whatever is made at first use has been made; then take the level."""
        load = Load(self.service.url, self._requests)
        await load.closed(4, seconds)
        load.close()
        await asyncio.sleep(1.0)
        self._level = processes.level(self.service.pid)

    async def under_load(
        self, account: Account, strike: Callable[[Account], Awaitable[None]], connections: int = 6
    ) -> Run:
        """Strike while so many connections are kept busy; the account is complete then, not judged."""
        load = Load(self.service.url, self._requests)
        loading = asyncio.create_task(load.closed(connections, 3600.0))
        await asyncio.sleep(1.0)
        try:
            await strike(account)
            await asyncio.sleep(1.0)
        finally:
            load.stopping = True
            run = await loading
            load.close()
        account.answers += run.verdicts
        account.left = await self.left_behind()
        return run

    async def workers(self, role: str) -> set[int]:
        """Process numbers of its workers of one role."""
        return await asyncio.to_thread(processes.workers, self.service.pid, role)

    async def is_ready(self) -> bool:
        """What /readyz says."""
        try:
            return (await get(self.service.url, "/readyz")).status == 200
        except (LostError, TimeoutError):
            return False

    async def recovered(
        self, account: Account, roles: Mapping[str, tuple[set[int], int]], *, stays_ready: bool = False
    ) -> bool:
        """Wait until, for each role, all of some processes are gone and a number of others is there, and the
        service says that it is ready; note the time. False where it does not come to that, or where the
        service was to stay ready and did not.
        """
        start = time.monotonic()
        while not ((ready := await self.is_ready()) and await self._is_whole(roles)):
            late = time.monotonic() - start > _GIVEN_UP_AFTER_S
            if late or self.service.process.poll() is not None or (stays_ready and not ready):
                account.wrong.append("it was not ready meanwhile" if stays_ready else "it did not recover")
                return False
            await asyncio.sleep(_LOOKS_EVERY_S)
        account.recoveries_s.append(time.monotonic() - start)
        return True

    async def left_behind(self) -> dict[str, int]:
        """What it holds above the level, once that has come down or will not."""
        assert self._level is not None
        end = time.monotonic() + _RECOVERS_WITHIN_S
        while left := (await asyncio.to_thread(processes.level, self.service.pid)).above(self._level):
            if time.monotonic() > end:
                break
            await asyncio.sleep(0.3)
        return left

    async def _is_whole(self, roles: Mapping[str, tuple[set[int], int]]) -> bool:
        for role, (gone, count) in roles.items():
            there = await self.workers(role)
            if there & gone or len(there) < count:
                return False
        return True


async def answer_or_end(connection: Connection, timeout_s: float) -> str:
    """The status that comes, or why none does."""
    try:
        return str((await connection.answer(timeout_s)).status)
    except LostError as error:
        return str(error)
    except TimeoutError:
        return HUNG
