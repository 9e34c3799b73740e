"""`boxlift export`: a trained network as an ONNX file for `boxlift detect` and `/detect`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from boxlift.errors import MissingExtraError


def export(
    run: Annotated[
        Path, typer.Argument(help="Folder of a run of `boxlift train`.", metavar="RUN", show_default=False)
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="The ONNX file to write.", show_default=False)],
    training_data: Annotated[
        str, typer.Option(metavar="TEXT", help="What it was trained on; the file carries it.")
    ] = "not stated",
    licence: Annotated[
        str, typer.Option(metavar="TEXT", help="Licence of the weights; the file carries it.")
    ] = "not stated",
) -> None:
    """Write what a run has trained so far as an ONNX file, to be used with --model or BOXLIFT_MODEL."""
    try:
        from boxlift.network.tasks import export_run
    except ModuleNotFoundError as error:
        raise MissingExtraError(error.name or "torch", "train") from None

    export_run(run, out, {"training_data": training_data, "licence": licence})
    print(f"The model is {out} ({out.stat().st_size / 1e6:.1f} MB).")
