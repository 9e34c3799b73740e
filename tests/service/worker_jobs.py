"""What the worker of test_worker_process is told to do; importable by name, as its process asks."""

from __future__ import annotations

import os
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from boxlift.errors import OptionsError


def open_counter(start: int) -> list[int]:
    """The state of the worker: a number that it counts on."""
    return [start]


def refuse() -> None:
    """An opener that finds its arguments wrong."""
    raise OptionsError("start", "it is wrong.", "Give another.")


def lacks_a_library() -> None:
    """An opener whose installation is broken."""
    raise ImportError("libGL.so.1 is missing")


def torch_threads(state: object) -> int:
    """How many threads torch computes with there."""
    del state
    import torch

    return int(torch.get_num_threads())


def crash() -> None:
    """An opener that ends its process."""
    os._exit(7)


@dataclass(frozen=True)
class Count:
    """Add to the state."""

    step: int

    def __call__(self, state: list[int]) -> tuple[int, int]:
        state[0] += self.step
        return os.getpid(), state[0]


@dataclass(frozen=True)
class Echo:
    """Give back what was sent."""

    data: bytes

    def __call__(self, state: list[int]) -> bytes:
        del state
        return self.data


def wrong_input(state: list[int]) -> None:
    """An input's fault."""
    raise OptionsError("step", f"{state[0]} is enough.", "Count on.")


def fault(state: list[int]) -> None:
    """A fault of the code."""
    raise ZeroDivisionError(f"at {state[0]}")


def kill_itself(state: list[int]) -> None:
    """As the kernel ends a process that takes too much memory."""
    del state
    os.kill(os.getpid(), signal.SIGKILL)


def hang(state: list[int]) -> None:
    """Never answer."""
    del state
    time.sleep(3600)


def modules(state: object) -> list[str]:
    """Names of what is loaded there."""
    del state
    return sorted(sys.modules)


@dataclass(frozen=True)
class Nap:
    """Work that takes a while, and tells who did it."""

    seconds: float

    def __call__(self, state: list[int]) -> int:
        del state
        time.sleep(self.seconds)
        return os.getpid()


def read_file(state: list[int], file: int) -> bytes:
    """Work on shared memory."""
    del state
    return os.pread(file, 100, 0)


def open_if_there(path: Path) -> list[int]:
    """An opener that needs a file; the state is the number in it."""
    if not path.exists():
        raise OptionsError("file", "it is not there.", "Put it there.")
    return [int(path.read_text())]


def opens_three_times(folder: Path) -> list[int]:
    """An opener that three processes may use, and no fourth."""
    folder.mkdir(exist_ok=True)
    for place in ("1", "2", "3"):
        try:
            (folder / place).touch(exist_ok=False)
        except FileExistsError:
            continue
        return [0]
    raise OptionsError("folder", "it was opened three times.", "Take another.")
