"""The command line, run in this process."""

from __future__ import annotations

from collections.abc import Callable


class Ran:
    """What a command printed, and its exit status."""

    def __init__(self, status: object, out: str, err: str) -> None:
        self.status, self.out, self.err = status, out, err


Boxlift = Callable[..., Ran]
