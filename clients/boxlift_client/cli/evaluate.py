"""`boxlift evaluate`: labels against the truth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal

import typer

from boxlift.datasets.frames_file import read_frames


def evaluate(
    gt: Annotated[
        Path,
        typer.Option(
            metavar="DIR", help="Folder with the truth: KITTI label files STEM.txt.", show_default=False
        ),
    ],
    pred: Annotated[
        Path,
        typer.Option(
            metavar="DIR", help="What `boxlift label` wrote: its folder, or its data/.", show_default=False
        ),
    ],
    frames: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="File with the frames to judge, one a line.  [default: all of --gt]"
        ),
    ] = None,
    metric: Annotated[Literal["kitti"], typer.Option(help="Whose rules.")] = "kitti",  # noqa: ARG001 - the only one
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
) -> None:
    """Judge labels: KITTI's average precision, and how well each prompt was lifted."""
    from boxlift.evaluation import evaluate_folders

    names = None if frames is None else read_frames(frames)
    evaluation = evaluate_folders(gt, pred, names)
    print(json.dumps(evaluation.to_json(), indent=2) if as_json else evaluation.to_table())
