"""`boxlift report`: a label set as one HTML file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from boxlift.storage import open_path


def report(
    labels: Annotated[
        str, typer.Argument(metavar="LABELS", help="What `boxlift label` wrote.", show_default=False)
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="The HTML file to write.")] = Path("report.html"),
    source: Annotated[
        str | None,
        typer.Option(
            metavar="DATASET",
            help="The data set, where it is not where it was labelled.",
            show_default=False,
        ),
    ] = None,
    gt: Annotated[
        str | None,
        typer.Option(metavar="NAME|DIR", help="The truth: label_2, or a folder of KITTI labels."),
    ] = None,
    pictures: Annotated[int, typer.Option(min=0, max=100, metavar="N", help="Frames to draw at most.")] = 20,
) -> None:
    """Write one HTML file about a label set: counts, scores, sizes, flags, time, the frames worth a look.

    With --gt also how good it is: precision, recall by difficulty, range and points, errors, how honest the
    scores are, the worst boxes, and sure boxes that the truth lacks. The file needs nothing else.
    """
    from boxlift_client.cli.progress import progress_bar
    from boxlift_client.report.page import write_report

    with progress_bar("Reading") as progress:
        page = write_report(
            open_path(labels), None if source is None else open_path(source), gt, pictures, progress
        )
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(page, encoding="utf-8")
    print(f"{out} ({len(page.encode()) / 2**20:.1f} MiB)")
