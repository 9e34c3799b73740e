"""`boxlift corrections`: what people said about a label set, laid over it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def corrections(
    labels: Annotated[
        Path,
        typer.Argument(metavar="LABELS", help="The label set that was reviewed.", show_default=False),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder of the corrected label set.  [default: LABELS/corrected]",
            show_default=False,
        ),
    ] = None,
    store: Annotated[
        str | None,
        typer.Option(
            metavar="URL",
            envvar="BOXLIFT_CORRECTIONS",
            help="Database of the corrections.  [default: LABELS/corrections.sqlite]",
            show_default=False,
        ),
    ] = None,
    name: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="What the review page calls the label set.  [default: the folder's name]",
            show_default=False,
        ),
    ] = None,
    rescore: Annotated[
        bool,
        typer.Option(
            "--rescore",
            help="Calibrate the scores of boxes that nobody judged by the verdicts on the others.",
        ),
    ] = False,
) -> None:
    """Write a label set of its own: LABELS with accepted, corrected and rejected boxes, and who said so.

    Prints how often flags and scores were right. LABELS stays as it is. Every command takes what comes out:
    convert, evaluate, show, serve.
    """
    from boxlift_client.corrected_set import CORRECTED, write_corrected_set

    folder = labels / CORRECTED if out is None else out
    print(write_corrected_set(labels, folder, store, name, rescore=rescore).text())
    print(f"Labels are in {folder / 'data'}, details in {folder / 'details'}.")
