"""Work that waits, by a few threads."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from itertools import islice
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_threads(work: Callable[[Item], Result], items: Iterable[Item], workers: int) -> Iterator[Result]:
    """What `work` says of every item, as it finishes, by that many threads; items are taken as needed."""
    waiting = iter(items)
    in_flight: set[Future[Result]] = set()
    pool = ThreadPoolExecutor(workers)
    try:
        while True:
            # One more for each thread, so that none waits for the caller.
            for item in islice(waiting, 2 * workers - len(in_flight)):
                in_flight.add(pool.submit(work, item))
            if not in_flight:
                return
            done, in_flight = wait(in_flight, return_when=FIRST_COMPLETED)
            yield from (future.result() for future in done)
    finally:
        pool.shutdown(cancel_futures=True)
