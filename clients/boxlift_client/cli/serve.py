"""`boxlift serve`: the HTTP service in this process."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def serve(
    host: Annotated[
        str | None, typer.Option(help="Address to listen on; 0.0.0.0: all.  [default: 127.0.0.1]")
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(min=0, max=65_535, help="Port to listen on; 0: a free one.  [default: 8000]"),
    ] = None,
    label_workers: Annotated[
        int | None, typer.Option(min=1, max=64, help="Processes that label.  [default: 1]")
    ] = None,
    model: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="ONNX file of a monocular model of your own.", show_default=False),
    ] = None,
    detector: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="ONNX file of a 2D detector of your own.", show_default=False),
    ] = None,
    label_sets: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Label set, or folder of label sets, for the review page; dropped frames are kept there.  "
            "[default: ./boxlift-review on loopback]",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Serve labels, detections and the review page over HTTP until interrupted.

    Every setting is also a variable BOXLIFT_*, e.g. BOXLIFT_MAX_POINTS; an option goes before it.
    """
    from boxlift_client import service_process

    given = {
        "host": host,
        "port": port,
        "label_workers": label_workers,
        "model": model,
        "detector": detector,
        "label_sets": label_sets,
    }
    service_process.serve({name: str(value) for name, value in given.items() if value is not None})
