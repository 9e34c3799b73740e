"""A part of a data set's frames, for one of many machines.

Which part a frame is in depends on its name alone (CRC-32 of it, modulo the number of parts): machines need
not agree on anything else, and a data set that grows does not move its earlier frames to other machines. The
parts are as even as chance makes them.
"""

from __future__ import annotations

import os
import re
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from boxlift.errors import OptionsError


@dataclass(frozen=True)
class Shard:
    """Part `index` of `count`, from 0."""

    index: int
    count: int

    def of(self, names: Iterable[str]) -> list[str]:
        """Those of the frames that are in this part."""
        return [name for name in names if zlib.crc32(name.encode()) % self.count == self.index]


def parse_shard(text: str, environment: Mapping[str, str] = os.environ) -> Shard:
    """`i/n`, or `auto`: what SLURM tells the tasks of an array. `auto/n`: of n, the one that a Kubernetes
    indexed job tells its pod.

    Raises OptionsError where the text is neither, or the environment says nothing.
    """
    index, _, count = text.partition("/")
    if index == "auto":
        return _from_environment(count, environment)
    if re.fullmatch(r"\d+/\d+", text) and int(index) < int(count):
        return Shard(int(index), int(count))
    raise OptionsError(
        "shard", f"{text!r} is no part of a whole.", "Give I/N with I from 0 to N - 1, as 0/4."
    )


def _from_environment(count: str, environment: Mapping[str, str]) -> Shard:
    def number(name: str) -> int | None:
        value = environment.get(name, "")
        return int(value) if value.isdigit() else None

    task, tasks, first = (number(f"SLURM_ARRAY_TASK_{name}") for name in ("ID", "COUNT", "MIN"))
    pod = number("JOB_COMPLETION_INDEX")
    if not count and task is not None and tasks is not None and first is not None:
        # An array may start anywhere, but has to go up by one.
        return _within(task - first, tasks)
    if count.isdigit() and pod is not None:
        return _within(pod, int(count))
    raise OptionsError(
        "shard",
        f"{'auto/' + count if count else 'auto'!r} finds no job that says which part this is.",
        "In a SLURM array say auto, in a Kubernetes indexed job auto/COMPLETIONS, elsewhere I/N.",
    )


def _within(index: int, count: int) -> Shard:
    if not 0 <= index < count:
        raise OptionsError(
            "shard",
            f"the job is number {index} of {count}.",
            "Number its tasks from one up, in steps of one.",
        )
    return Shard(index, count)
