"""Back-pressure by work: a bounded number of permits, and a refusal instead of an endless queue."""

from __future__ import annotations

import asyncio
import math
from collections import deque
from time import monotonic

from boxlift_service.problems import Kind, ProblemError

_LONGEST_RETRY_S = 60
# How much of the measured rate the newest work is: after ten pieces of work the old is forgotten.
_NEWEST = 0.1
_NOTHING = 1e-9


class Permits:
    """`total` permits for work that is computed or waits; who asks for more than are left is refused.

    Not for several threads: it belongs to the event loop.
    """

    def __init__(self, total: float) -> None:
        self.total = total
        self.taken = 0.0
        self._entrance: deque[tuple[asyncio.Future[None], float]] = deque()
        self._rate = 0.0
        self._busy_since = monotonic()

    @property
    def exhausted(self) -> bool:
        """Whether even the smallest work would be refused."""
        return self.taken >= self.total

    async def take(self, work: float, *, wait: bool = False) -> float:
        """Take permits for `work`; returns how many, to be given back.

        Work of more than half of all permits takes half of them, so that it is done at all. wait: until there
        are some, in the order of asking. Raises ProblemError (429) where there are too few, unless it waits.
        """
        work = min(work, self.total / 2)
        if self._fits(work) and not (wait and self._entrance):
            self._take(work)
        elif wait:
            await self._turn(work)
        else:
            raise self.refusal()
        return work

    def give_back(self, work: float) -> None:
        """The counterpart of take, when the work is done or dropped."""
        now = monotonic()
        rate = work / max(now - self._busy_since, 1e-3)
        self._rate = rate if self._rate <= 0 else (1 - _NEWEST) * self._rate + _NEWEST * rate
        self._busy_since = now
        # Sums of fractions leave a little behind.
        self.taken = self.taken - work if self.taken - work > _NOTHING else 0.0
        self._admit()

    def _fits(self, work: float) -> bool:
        return self.taken + work <= self.total

    def _take(self, work: float) -> None:
        if self.taken == 0:
            self._busy_since = monotonic()
        self.taken += work

    def refusal(self) -> ProblemError:
        """What a request beyond the permits is answered."""
        seconds = self.seconds_of_work()
        return ProblemError(
            Kind.TOO_BUSY,
            f"{self.taken:.1f} of {self.total:g} permits for work are taken.",
            f"Try again in {seconds} s.",
            headers={"Retry-After": str(seconds)},
        )

    def seconds_of_work(self) -> int:
        """How long the work that was taken on will last, as far as the work before tells; 1 to 60."""
        if self._rate <= 0:
            return 1
        return max(1, min(_LONGEST_RETRY_S, math.ceil(self.taken / self._rate)))

    async def _turn(self, work: float) -> None:
        """Wait at the entrance; who lets in takes the permits."""
        turn: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._entrance.append((turn, work))
        try:
            await turn
        except asyncio.CancelledError:
            if turn.cancelled():
                self._admit()  # those behind may fit
            else:
                self.give_back(work)
            raise

    def _admit(self) -> None:
        """Let in who waits, in their order, as far as there is room."""
        while self._entrance:
            turn, work = self._entrance[0]
            if not turn.done():
                if not self._fits(work):
                    return
                self._take(work)
                turn.set_result(None)
            self._entrance.popleft()
