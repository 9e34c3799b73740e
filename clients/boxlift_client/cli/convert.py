"""`boxlift convert`: a label set in other formats."""

from __future__ import annotations

from typing import Annotated

import typer

from boxlift.storage import open_path
from boxlift_client.convert import Converted, Format
from boxlift_client.convert import convert as convert_label_set
from boxlift_client.summary import counted


def convert(
    labels: Annotated[
        str,
        typer.Argument(
            metavar="LABELS", help="What `boxlift label` or `boxlift detect` wrote.", show_default=False
        ),
    ],
    to: Annotated[Format, typer.Option(help="The format: see docs/conventions.md.", show_default=False)],
    out: Annotated[
        str,
        typer.Option(
            metavar="PATH",
            help="Where to: a folder; a .parquet or .feather file for argoverse2, a .json file for nuscenes.",
            show_default=False,
        ),
    ],
    source: Annotated[
        str | None,
        typer.Option(
            metavar="DATASET",
            help="The data set that was labelled, for points and images in supervisely, mcap and rerun.",
        ),
    ] = None,
    min_score: Annotated[float, typer.Option(min=0, max=1, help="Leave out boxes with a lower score.")] = 0.0,
) -> None:
    """Write labels in another format: KITTI (objects or tracks), Argoverse 2 (Parquet), OpenLABEL,
    Supervisely, nuScenes, MCAP or Rerun."""
    from boxlift_client.cli.progress import progress_bar

    with progress_bar("Converting") as on_progress:
        done = convert_label_set(
            open_path(labels),
            to,
            open_path(out),
            min_score=min_score,
            source=None if source is None else open_path(source),
            on_progress=on_progress,
        )
    print(_sentence(done, to, out))


def _sentence(done: Converted, to: Format, out: str) -> str:
    what = "frame" if to is Format.KITTI else "sweep"
    lines = [f"{done.boxes} boxes of {counted(done.units, what)} are in {out}."]
    lines += [
        f"{count} boxes of class {name} were left out: {to} has no such class."
        for name, count in sorted(done.left_out.items())
    ]
    if done.without_sensors:
        lines.append(f"Points or images of {done.without_sensors} sweeps could not be read.")
    return "\n".join(lines)
