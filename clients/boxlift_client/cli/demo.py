"""`boxlift demo`: the whole of boxlift on generated frames."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def demo(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for frames, labels and pictures.")] = Path(
        "demo"
    ),
    frames: Annotated[int, typer.Option(min=1, max=1000, help="How many frames.")] = 12,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first frame.")] = 0,
) -> None:
    """Generate frames, label them over HTTP with 2D boxes and without, judge the labels, draw them."""
    from boxlift_client.demo import run_demo

    if not run_demo(out, frames, seed):
        raise typer.Exit(1)
