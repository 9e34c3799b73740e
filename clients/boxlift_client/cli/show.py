"""`boxlift show`: one frame as a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from boxlift.formats.size_priors import read_size_priors
from boxlift.settings import DEFAULT_PRESET, PRESETS, preset
from boxlift_client.cli.detection import DetectorOption, MinScoreOption, with_detection


def show(
    source: Annotated[
        Path, typer.Argument(metavar="SOURCE", help="Dataset root or folder.", show_default=False)
    ],
    frame: Annotated[
        str, typer.Argument(metavar="FRAME", help="Name of the frame (its file's stem).", show_default=False)
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="Picture to write (.png).", show_default=False)],
    pred: Annotated[
        Path | None, typer.Option(metavar="DIR", help="What `boxlift label` wrote: draw its boxes.")
    ] = None,
    prompts: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|DIR",
            help="label_2, det_2d, a folder, or detector: without --pred, label these and draw the boxes.",
        ),
    ] = None,
    detector: DetectorOption = None,
    min_score: MinScoreOption = None,
    gt: Annotated[
        str | None, typer.Option(metavar="NAME|DIR", help="The truth: label_2, or a folder of KITTI labels.")
    ] = None,
    preset_name: Annotated[
        str,
        typer.Option(
            "--preset", metavar="NAME", help=f"Settings to label --prompts with: {', '.join(PRESETS)}."
        ),
    ] = DEFAULT_PRESET,
    priors: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="TOML file with sizes per class to label --prompts with."),
    ] = None,
) -> None:
    """Draw one frame: the image, and below it the bird's-eye view, with points, prompts, boxes, truth."""
    from boxlift_client.pictures import draw_labels_on_disk, draw_new_labels, write_picture

    if pred is not None:
        picture = draw_labels_on_disk(source, frame, pred, gt)
    else:
        settings = with_detection(preset(preset_name), prompts, detector, min_score)
        if priors is not None:
            settings = settings.with_sizes(read_size_priors(priors))
        picture = draw_new_labels(source, frame, prompts, gt, settings, detector)
    write_picture(out, picture)
    print(out)
