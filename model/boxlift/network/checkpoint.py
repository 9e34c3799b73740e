"""Checkpoints that survive a kill: written beside the old one, then renamed over it.

What is random in an epoch is seeded from the run's seed and the epoch's number alone (see trainer.py), so no
state of a generator has to be kept.
"""

from __future__ import annotations

import io
import os
from dataclasses import dataclass
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch

from boxlift.errors import OptionsError

# One row per epoch: figures by name.
Curve = list[dict[str, float]]

_FORMAT = 1
CHECKPOINT_NAME = "checkpoint.pt"


@dataclass(frozen=True)
class Checkpoint:
    """A run after `epoch` whole epochs.

    fingerprint: of the settings; a run goes on only with the same ones.
    model, optimizer: state dicts. curve: one row per epoch so far.
    """

    fingerprint: str
    epoch: int
    model: dict[str, Any]
    optimizer: dict[str, Any]
    curve: Curve


def write_checkpoint(path: Path, checkpoint: Checkpoint) -> None:
    """Replace the checkpoint at `path`; at every moment the old or the new one is there, whole."""
    buffer = io.BytesIO()
    torch.save({"format": _FORMAT, **vars(checkpoint)}, buffer)
    write_atomically(path, buffer.getvalue())


def read_checkpoint(path: Path, fingerprint: str | None = None) -> Checkpoint | None:
    """The checkpoint at `path`, None where there is none.

    Raises OptionsError where the file is none, or is of a run with another `fingerprint`, where one is given.
    """
    if not path.exists():
        return None
    try:
        values = torch.load(path, map_location="cpu", weights_only=True)
        if values.pop("format") != _FORMAT:
            raise KeyError("format")
        checkpoint = Checkpoint(**values)
    except (OSError, RuntimeError, EOFError, UnpicklingError, KeyError, TypeError, AttributeError) as error:
        raise OptionsError(
            str(path), f"the file is no checkpoint of this program ({error!s:.120}).", "Name another folder."
        ) from None
    if fingerprint not in (None, checkpoint.fingerprint):
        raise OptionsError(
            str(path.parent),
            "the folder holds a run with other settings.",
            "Name another folder, or give the settings that the run began with.",
        )
    return checkpoint


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file so that a kill at any moment leaves the old content or the new, never a part."""
    partial = path.with_name(f".{path.name}.partial")
    with partial.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)
