"""The trainer: any Task, seeded, a checkpoint per epoch; a killed run goes on to the same curve, bit by bit.

An epoch's random choices (order, augmentation, dropout) are seeded from the run's seed and the epoch's
number, so that it does not matter which process lived through the epochs before.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any, Protocol

import torch
from torch import Tensor, nn

from boxlift.errors import OptionsError
from boxlift.network.checkpoint import CHECKPOINT_NAME, Checkpoint, Curve, read_checkpoint, write_checkpoint
from boxlift.network.config import TrainerSettings
from boxlift.network.curve import CurveFiles
from boxlift.network.machine import Machine, open_machine
from boxlift.network.task import Batch, Task
from boxlift.seeds import seed_of


class Watcher(Protocol):
    """Is told how a training goes."""

    def on_step(self, epoch: int, step: int, loss: float) -> None:
        """Batch `step` of `epoch` (both from 0) had this loss."""

    def on_epoch(self, curve: Curve) -> None:
        """An epoch has ended: its figures are the last row."""


class _Nobody:
    def on_step(self, epoch: int, step: int, loss: float) -> None:
        pass

    def on_epoch(self, curve: Curve) -> None:
        pass


def train(
    task: Task[Batch],
    settings: TrainerSettings,
    folder: Path,
    fingerprint: str,
    watcher: Watcher | None = None,
) -> tuple[nn.Module, Curve]:
    """Train in `folder`, or go on where a run with the same `fingerprint` ended; the model and its curve.

    The folder then holds checkpoint.pt, metrics.jsonl and, where TensorBoard is installed, tensorboard/.
    The model comes back on the CPU in evaluation mode. Raises OptionsError where the folder holds another
    run, or where the loss is no number any more.
    """
    machine = open_machine(settings.machine)
    keeps_books = machine.rank == 0
    watcher = watcher or _Nobody()
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / CHECKPOINT_NAME
    checkpoint = read_checkpoint(path, fingerprint)

    torch.manual_seed(settings.seed)
    model = task.build(torch.Generator().manual_seed(settings.seed))
    if checkpoint is not None:
        model.load_state_dict(checkpoint.model)
    placed, optimizer = machine.place(model, _optimizer(model, settings))
    curve: Curve = []
    if checkpoint is not None:
        optimizer.load_state_dict(checkpoint.optimizer)
        curve = checkpoint.curve
    files = CurveFiles(folder, curve) if keeps_books else None
    for epoch in range(len(curve), settings.epochs):
        row = _train_epoch(task, placed, optimizer, machine, settings, epoch, watcher)
        if keeps_books:
            last = epoch + 1 == settings.epochs
            if last or (settings.evaluate_every and (epoch + 1) % settings.evaluate_every == 0):
                row |= _evaluate(task, model)
            curve.append(row)
            states = model.state_dict(), optimizer.state_dict()
            write_checkpoint(path, Checkpoint(fingerprint, epoch + 1, *states, curve))
            assert files is not None
            files.add(curve)
            watcher.on_epoch(curve)
        machine.wait()
    if files is not None:
        files.close()
    return model.cpu().eval(), curve


def learning_rate(settings: TrainerSettings, epoch: int) -> float:
    """The learning rate of an epoch (the first is 0)."""
    rate = settings.learning_rate
    if epoch < settings.warmup_epochs:
        return rate * (epoch + 1) / (settings.warmup_epochs + 1)
    if settings.schedule == "cosine":
        done = (epoch - settings.warmup_epochs) / max(1, settings.epochs - settings.warmup_epochs)
        rate *= (1 + math.cos(math.pi * done)) / 2
    return rate


def _optimizer(model: nn.Module, settings: TrainerSettings) -> torch.optim.Optimizer:
    parameters = [parameter for parameter in model.parameters() if parameter.requires_grad]
    kind = torch.optim.AdamW if settings.optimizer == "adamw" else torch.optim.Adam
    return kind(parameters, lr=settings.learning_rate, weight_decay=settings.weight_decay)


def _train_epoch(
    task: Task[Batch],
    model: nn.Module,
    optimizer: Any,
    machine: Machine,
    settings: TrainerSettings,
    epoch: int,
    watcher: Watcher,
) -> dict[str, float]:
    """One pass over the batches; the means of the loss and its terms."""
    seed = seed_of(settings.seed, epoch)
    torch.manual_seed(seed)
    rate = learning_rate(settings, epoch)
    for group in optimizer.param_groups:
        group["lr"] = rate
    model.train()
    sums: dict[str, float] = {}
    steps = 0
    for batch in _share(task.batches(epoch, torch.Generator().manual_seed(seed)), machine):
        terms = task.loss(model, machine.to_device(batch))
        total = torch.stack([term.float() for term in terms.values()]).sum()
        values = {"loss": total, **{f"loss/{name}": term for name, term in terms.items()}}
        _require_finite(values, epoch, steps)
        optimizer.zero_grad(set_to_none=True)
        machine.backward(total)
        if settings.clip_norm is not None:
            machine.clip(model, optimizer, settings.clip_norm)
        optimizer.step()
        for name, value in values.items():
            sums[name] = sums.get(name, 0.0) + float(value.detach())
        watcher.on_step(epoch, steps, float(total.detach()))
        steps += 1
    if not steps:
        raise OptionsError("data", "there is no batch to train on.", "Name frames with usable objects.")
    means = {name: machine.mean(value / steps) for name, value in sorted(sums.items())}
    return {"epoch": epoch + 1, "learning_rate": rate, **means}


def _share(batches: Iterable[Batch], machine: Machine) -> Iterator[Batch]:
    """Every process's own batches; of a last round that is not full there are none."""
    if machine.processes == 1:
        yield from batches
        return
    rounds = iter(batches)
    while len(together := list(islice(rounds, machine.processes))) == machine.processes:
        yield together[machine.rank]


def _require_finite(values: dict[str, Tensor], epoch: int, step: int) -> None:
    wrong = [name for name, value in values.items() if not torch.isfinite(value)]
    if wrong:
        raise OptionsError(
            "trainer",
            f"{', '.join(wrong)} became infinite or no number in step {step + 1} of epoch {epoch + 1}.",
            "Lower learning_rate, or set clip_norm.",
        )


def _evaluate(task: Task[Batch], model: nn.Module) -> dict[str, float]:
    model.eval()
    with torch.no_grad():
        return task.evaluate(model)
