"""What the trainer asks of a training: a model, batches, losses, and how good the model is."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol, TypeVar

import torch
from torch import Tensor, nn

Batch = TypeVar("Batch")


class Task(Protocol[Batch]):
    """One training. Everything random comes from the generators that it is given, or from torch's own."""

    def build(self, rng: torch.Generator) -> nn.Module:
        """The untrained model, on the CPU. torch's own generator is seeded, too; layers draw from that.

        Parameters that do not require a gradient stay as they are.
        """

    def batches(self, epoch: int, generator: torch.Generator) -> Iterable[Batch]:
        """The batches of an epoch (the first is 0): tensors on the CPU, in dicts, lists or dataclasses.

        The same epoch and seed give the same batches, whatever was asked before.
        """

    def loss(self, model: nn.Module, batch: Batch) -> dict[str, Tensor]:
        """The terms whose sum is minimised, scalars, by name. Calls `model` itself and not its parts,

        since several GPUs know of its gradients only then.
        """

    def evaluate(self, model: nn.Module) -> dict[str, float]:
        """Figures by name after an epoch; the model is in evaluation mode, without gradients."""
