"""How long a client waits, and whether it still does: work for nobody is dropped."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Coroutine
from contextlib import asynccontextmanager
from time import monotonic
from typing import Any, TypeVar

from starlette.requests import ClientDisconnect, Request

from boxlift_service.problems import Kind, ProblemError

T = TypeVar("T")

HEADER = "X-Request-Timeout"
_LONGEST_S = 86_400.0


class Deadline:
    """A moment, `seconds` from now, after which nobody waits for the answer."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._end = monotonic() + seconds

    @classmethod
    def of(cls, request: Request) -> Deadline | None:
        """What the request's X-Request-Timeout says, in seconds. Raises ProblemError (422) for nonsense."""
        text = request.headers.get(HEADER)
        if text is None:
            return None
        try:
            seconds = float(text)
        except ValueError:
            seconds = math.nan
        if not 0 < seconds <= _LONGEST_S:
            raise ProblemError(
                Kind.INVALID_FIELD,
                f"The header {HEADER} is {text!r:.60}.",
                f"Give seconds, more than 0 and at most {_LONGEST_S:g}, or leave it out.",
                field=HEADER,
            )
        return cls(seconds)

    def seconds_left(self) -> float:
        """Negative once it has passed."""
        return self._end - monotonic()

    def problem(self) -> ProblemError:
        """The answer when it has passed."""
        return ProblemError(
            Kind.DEADLINE_EXCEEDED,
            f"There was no answer within the {self._seconds:g} s of {HEADER}.",
            "Give more time, or try again when the service is less busy.",
        )


@asynccontextmanager
async def within(deadline: Deadline | None) -> AsyncIterator[None]:
    """Cancel the body of the `async with` when the deadline passes, and raise ProblemError (504).

    Where it has passed, nothing is begun.
    """
    if deadline is not None and deadline.seconds_left() <= 0:
        raise deadline.problem()
    try:
        async with asyncio.timeout(None if deadline is None else deadline.seconds_left()) as limit:
            yield
    except TimeoutError:
        if deadline is None or not limit.expired():
            raise
        raise deadline.problem() from None


async def unless_gone(request: Request, work: Coroutine[Any, Any, T]) -> T:
    """What `work` returns; it is cancelled when the client goes away, and ClientDisconnect raised.

    For requests whose body has been read to its end.
    """
    working = asyncio.ensure_future(work)
    leaving = asyncio.ensure_future(_left(request))
    try:
        await asyncio.wait((working, leaving), return_when=asyncio.FIRST_COMPLETED)
        if working.done():
            return working.result()
        raise ClientDisconnect
    finally:
        for task in (working, leaving):
            task.cancel()
        await asyncio.gather(working, leaving, return_exceptions=True)


async def _left(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass
