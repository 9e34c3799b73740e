"""Ctrl-C and SIGTERM end a run alike: nothing is lost, and the same command goes on."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import typer

_INTERRUPTED = 130  # as shells count: 128 + SIGINT
_TERMINATED = 143  # 128 + SIGTERM


@contextmanager
def resumable(out: str) -> Iterator[None]:
    """What is finished stays in `out`. SIGTERM is what clusters send before they take a machine."""

    def interrupt(signum: int, _: object) -> None:
        raise KeyboardInterrupt(signum)

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    except KeyboardInterrupt as interrupted:
        print(f"Interrupted. What was finished is in {out}; the same command goes on.", file=sys.stderr)
        raise typer.Exit(_TERMINATED if interrupted.args else _INTERRUPTED) from None
    finally:
        signal.signal(signal.SIGTERM, before)
