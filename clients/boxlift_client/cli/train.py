"""`boxlift train`: a TOML file in, a trained network out."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from boxlift.errors import MissingExtraError

if TYPE_CHECKING:
    from boxlift.network.checkpoint import Curve

_INTERRUPTED = 130  # as shells count: 128 + SIGINT
_RUNS = Path("runs")
_SHOWN = 4  # figures of an evaluation


def _print_keys(wanted: bool) -> None:
    if wanted:
        from boxlift.network.tasks import TASKS, keys_of

        for name in TASKS:
            print(f'task = "{name}"', *keys_of(name), sep="\n", end="\n\n")
        raise typer.Exit


def train(
    config: Annotated[
        Path,
        typer.Argument(
            help="TOML file; docs/training.md shows one. Paths in it are relative to its folder.",
            metavar="CONFIG",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder of the run: checkpoint.pt, metrics.jsonl, tensorboard/.  [default: runs/CONFIG]",
            show_default=False,
        ),
    ] = None,
    keys: Annotated[  # noqa: ARG001 - its callback does it
        bool,
        typer.Option("--keys", callback=_print_keys, is_eager=True, help="List the keys of the file."),
    ] = False,
) -> None:
    """Train a monocular network, with LiDAR as the only supervision.

    A run that was interrupted or killed goes on where its last epoch ended when the same command is given
    again, and ends with the same numbers.
    """
    try:
        from boxlift.network.tasks import read_config
        from boxlift.network.trainer import train as run
    except ModuleNotFoundError as error:
        raise MissingExtraError(error.name or "torch", "train") from None

    settings = read_config(config)
    folder = out or _RUNS / config.stem
    try:
        with Console(stderr=True).status("Reading frames and what supervises them"):
            task = settings.make_task(folder)
        with _Bar(settings.settings.trainer.epochs) as bar:
            _, curve = run(task, settings.settings.trainer, folder, settings.fingerprint, bar)
    except KeyboardInterrupt:
        print(f"Interrupted. The same command goes on from the last epoch in {folder}.", file=sys.stderr)
        raise typer.Exit(_INTERRUPTED) from None
    if curve:  # of several processes only the first keeps the books
        print(f"{_line(curve)}\nThe run is in {folder}.")


class _Bar:
    """A progress bar over epochs where stderr is a terminal; else a line per epoch."""

    def __init__(self, epochs: int) -> None:
        self._shown = sys.stderr.isatty()
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            console=Console(stderr=True),
            transient=True,
            disable=not self._shown,
        )
        self._bar = self._progress.add_task("Training", total=epochs)

    def __enter__(self) -> _Bar:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def on_step(self, epoch: int, step: int, loss: float) -> None:
        """See Watcher."""
        description = f"Training: epoch {epoch + 1}, step {step + 1}, loss {loss:.4g}"
        self._progress.update(self._bar, description=description, completed=epoch)

    def on_epoch(self, curve: Curve) -> None:
        """See Watcher."""
        self._progress.update(self._bar, completed=len(curve))
        if not self._shown:
            print(_line(curve), file=sys.stderr)


def _line(curve: Curve) -> str:
    """The last epoch in words: losses, and the first of its other figures; metrics.jsonl has all."""
    row = curve[-1]
    losses = [f"{name.removeprefix('loss/')} {value:.4g}" for name, value in row.items() if "loss" in name]
    others = [
        f"{name} {value:.4g}"
        for name, value in row.items()
        if "loss" not in name and name not in ("epoch", "learning_rate")
    ]
    return (
        f"Epoch {row['epoch']:g}: {'; '.join(filter(None, (', '.join(losses), ', '.join(others[:_SHOWN]))))}"
    )
