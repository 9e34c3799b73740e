"""A training that takes a moment: a linear model with dropout. As a program it is there to be killed.

python small_training.py FOLDER EPOCHS SECONDS_PER_BATCH
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path

import torch
from torch import Tensor, nn

from boxlift.network.config import TrainerSettings
from boxlift.network.trainer import train


class SmallTask:
    """Regression to y = 2 x[0] - x[1] from batches in random order."""

    def __init__(self, seconds_per_batch: float = 0.0) -> None:
        self._pause_s = seconds_per_batch

    def build(self, rng: torch.Generator) -> nn.Module:
        model = nn.Sequential(nn.Linear(4, 16), nn.Dropout(0.2), nn.BatchNorm1d(16), nn.Linear(16, 1))
        nn.init.normal_(next(model.parameters()), generator=rng)
        return model

    def batches(self, epoch: int, generator: torch.Generator) -> Iterator[dict[str, Tensor]]:
        inputs = torch.randn(6, 8, 4, generator=torch.Generator().manual_seed(7))
        noise = torch.randn(6, 8, 4, generator=generator) / (epoch + 1)
        for index in torch.randperm(6, generator=generator).tolist():
            time.sleep(self._pause_s)
            yield {"x": inputs[index] + noise[index], "y": 2 * inputs[index, :, :1] - inputs[index, :, 1:2]}

    def loss(self, model: nn.Module, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        error = model(batch["x"]) - batch["y"]
        return {"square": error.square().mean(), "absolute": 0.1 * error.abs().mean()}

    def evaluate(self, model: nn.Module) -> dict[str, float]:
        return {"at_one": float(model(torch.ones(1, 4)).detach())}


def settings(epochs: int) -> TrainerSettings:
    """Seeded, with a schedule."""
    return TrainerSettings(
        seed=3, epochs=epochs, learning_rate=0.01, schedule="cosine", warmup_epochs=1, clip_norm=1.0
    )


if __name__ == "__main__":
    train(SmallTask(float(sys.argv[3])), settings(int(sys.argv[2])), Path(sys.argv[1]), "small")
