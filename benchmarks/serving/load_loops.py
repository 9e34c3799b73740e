"""Load on a service: a closed loop, where each connection waits for its answer, and an open loop.

In an open loop requests arrive by a Poisson process whatever the service does, and latency counts from
when a request was due: a service that stalls is charged for all that waited meanwhile.
"""

from __future__ import annotations

import asyncio
import random
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from serving.connection import Answer, Connection, LostError
from serving.prepared import Prepared

OK = "ok"
REFUSED = "429"
HUNG = "hung"

# Below the keep-alive time of the services: a connection that rested longer might just be closing.
_RESTS_AT_MOST_S = 3.0
# Requests that wait; what is due beyond them is counted and not sent.
_MOST_WAITING = 800
# A client of a closed loop that got no answer 200 breathes before it asks again.
_BREATHES_S = 0.1


@dataclass(frozen=True)
class Outcome:
    """What became of a request; times are seconds since its run began.

    verdict: OK, REFUSED (429 with Retry-After), another status with the kind of its problem, HUNG, or how
    the connection was lost.
    """

    kind: str
    due_s: float
    end_s: float
    verdict: str


@dataclass
class Run:
    """A run of load, filled while it lasts.

    generator_cpu_s: what making the load took of this process. began: by time.perf_counter().
    """

    seconds: float = 0.0
    generator_cpu_s: float = 0.0
    outcomes: list[Outcome] = field(default_factory=list)
    began: float = field(default_factory=time.perf_counter)
    _cpu: float = field(default_factory=time.process_time)

    @property
    def now_s(self) -> float:
        """Seconds since it began."""
        return time.perf_counter() - self.began

    def end(self, seconds: float) -> None:
        """Load was made for so long."""
        self.seconds = seconds
        self.generator_cpu_s = time.process_time() - self._cpu

    @property
    def verdicts(self) -> Counter[str]:
        """How many requests ended how."""
        return Counter(one.verdict for one in self.outcomes)

    @property
    def errors(self) -> int:
        """Requests that were neither answered with 200 nor refused as they should."""
        return sum(one.verdict not in (OK, REFUSED) for one in self.outcomes)

    def per_second(self, kind: str | None = None) -> float:
        """Answers 200 a second, while load was made."""
        ended = [one for one in self.outcomes if one.verdict == OK and one.end_s <= self.seconds]
        return sum(kind in (None, one.kind) for one in ended) / self.seconds

    def latencies_s(self, kind: str | None = None) -> list[float]:
        """Of answers 200, sorted: from when a request was due to the end of its answer."""
        chosen = (one for one in self.outcomes if one.verdict == OK and kind in (None, one.kind))
        return sorted(one.end_s - one.due_s for one in chosen)


def quantile(ordered: Sequence[float], share: float) -> float:
    """The least of some sorted values that at least `share` of them do not exceed; NaN of none."""
    if not ordered:
        return float("nan")
    return ordered[max(0, min(len(ordered) - 1, round(share * len(ordered)) - 1))]


class Load:
    """Load on the service at `url`, from a stream of requests.

    timeout_s: what is not answered by then counts as hung. Once `stopping` is set a run begins no more
    requests.
    """

    def __init__(self, url: str, requests: Iterator[Prepared], timeout_s: float = 60.0) -> None:
        self.url = url
        self.stopping = False
        self._requests = requests
        self._timeout_s = timeout_s
        self._resting: list[tuple[float, Connection]] = []

    async def closed(self, connections: int, seconds: float) -> Run:
        """So many connections with one request at a time each."""
        run = Run()

        async def client() -> None:
            while run.now_s < seconds and not self.stopping:
                outcome = await self._ask(next(self._requests), run, run.now_s)
                if outcome.verdict != OK:
                    await asyncio.sleep(_BREATHES_S)

        async with asyncio.TaskGroup() as clients:
            for _ in range(connections):
                clients.create_task(client())
        run.end(min(seconds, run.now_s))
        return run

    async def open(self, per_second: float, seconds: float, seed: int = 0) -> Run:
        """Poisson arrivals."""
        draw = random.Random(seed)
        run = Run()
        due_s = draw.expovariate(per_second)
        waiting: set[asyncio.Task[Outcome]] = set()
        async with asyncio.TaskGroup() as arrivals:
            while due_s < seconds and not self.stopping:
                await asyncio.sleep(max(0.0, due_s - run.now_s))
                request = next(self._requests)
                if len(waiting) < _MOST_WAITING:
                    task = arrivals.create_task(self._ask(request, run, due_s))
                    waiting.add(task)
                    task.add_done_callback(waiting.discard)
                else:
                    run.outcomes.append(Outcome(request.kind, due_s, run.now_s, "not sent: too many wait"))
                due_s += draw.expovariate(per_second)
            ended_s = min(seconds, run.now_s) if self.stopping else seconds
        run.end(ended_s)
        return run

    def close(self) -> None:
        """End the connections that rest."""
        for _, connection in self._resting:
            connection.close()
        self._resting.clear()

    async def _ask(self, request: Prepared, run: Run, due_s: float) -> Outcome:
        """Send a request and note what becomes of it."""
        connection = None
        try:
            connection = self._rested() or await Connection.open(self.url)
            answer = await connection.ask(request.data, self._timeout_s)
        except LostError as error:
            verdict = str(error)
        except TimeoutError:
            verdict = HUNG
        else:
            verdict = _verdict(answer)
            if connection.reusable and not answer.closes:
                self._resting.append((time.monotonic(), connection))
                connection = None
        finally:
            if connection is not None:
                connection.close()
        outcome = Outcome(request.kind, due_s, run.now_s, verdict)
        run.outcomes.append(outcome)
        return outcome

    def _rested(self) -> Connection | None:
        """The connection that rested shortest, if any is still good; the others grow old and are closed."""
        now = time.monotonic()
        while self._resting and now - self._resting[0][0] > _RESTS_AT_MOST_S:
            self._resting.pop(0)[1].close()
        while self._resting:
            _, connection = self._resting.pop()
            if connection.reusable:
                return connection
        return None


def _verdict(answer: Answer) -> str:
    if answer.status == 200:
        return OK
    if answer.status == 429 and "retry-after" in answer.headers:
        return REFUSED
    return f"{answer.status} {answer.slug}".strip()
