"""Where the figures of a run go: metrics.jsonl, a line per epoch, and TensorBoard where it is installed."""

from __future__ import annotations

import importlib
import json
from pathlib import Path
from typing import Any

from boxlift.network.checkpoint import Curve, write_atomically

METRICS_NAME = "metrics.jsonl"
TENSORBOARD_NAME = "tensorboard"


class CurveFiles:
    """The files of a run's curve. `curve`: the epochs that a resumed run has behind it.

    metrics.jsonl is written anew each time: an epoch that a killed run had finished but not kept in its
    checkpoint is in it only once. There is no time of day in it, so equal runs give equal bytes.
    """

    def __init__(self, folder: Path, curve: Curve) -> None:
        self._path = folder / METRICS_NAME
        self._tensorboard = _tensorboard(folder / TENSORBOARD_NAME, epochs_done=len(curve))
        self._write(curve)

    def add(self, curve: Curve) -> None:
        """The curve has grown by its last row."""
        self._write(curve)
        if self._tensorboard is not None:
            for name, value in curve[-1].items():
                self._tensorboard.add_scalar(name, value, len(curve))
            self._tensorboard.flush()

    def close(self) -> None:
        """Everything is written."""
        if self._tensorboard is not None:
            self._tensorboard.close()

    def _write(self, curve: Curve) -> None:
        write_atomically(self._path, "".join(f"{json.dumps(row)}\n" for row in curve).encode())


def read_metrics(folder: Path) -> Curve:
    """The curve in a run's folder."""
    return [json.loads(line) for line in (folder / METRICS_NAME).read_text(encoding="utf-8").splitlines()]


def _tensorboard(folder: Path, epochs_done: int) -> Any:  # tensorboard ships no types
    try:
        writer = importlib.import_module("torch.utils.tensorboard").SummaryWriter
    except ImportError:
        return None
    # What a killed run wrote after its last checkpoint is not shown.
    return writer(str(folder), purge_step=epochs_done + 1)
