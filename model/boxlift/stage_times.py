"""How long each stage of a label took."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import perf_counter


@dataclass
class StageTimes:
    """Seconds per stage of one `label` call, in the order the stages ran."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the body of a `with` under `name`."""
        start = perf_counter()
        yield
        self.seconds[name] = perf_counter() - start
