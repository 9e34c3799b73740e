"""`boxlift show`: one frame as a picture or a recording, or the newest of a run."""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from boxlift.errors import OptionsError
from boxlift.formats.size_priors import read_size_priors
from boxlift.settings import DEFAULT_PRESET, PRESETS, preset
from boxlift_client.cli.detection import DetectorOption, MinScoreOption, with_detection


def show(
    source: Annotated[
        Path, typer.Argument(metavar="SOURCE", help="Dataset root or folder.", show_default=False)
    ],
    out: Annotated[
        Path,
        typer.Option(metavar="FILE", help="Picture to write (.png), or .rrd.", show_default=False),
    ],
    frame: Annotated[
        str | None,
        typer.Argument(
            metavar="FRAME",
            help="Name of the frame (its stem); none with --watch.",
            show_default=False,
        ),
    ] = None,
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
    rerun: Annotated[
        bool,
        typer.Option(
            "--rerun", help="Write a recording of Rerun (FILE.rrd): points, image and the boxes of --pred."
        ),
    ] = False,
    watch: Annotated[
        bool,
        typer.Option(
            "--watch", help="Draw the newest frame of --pred again and again while a run writes it."
        ),
    ] = False,
) -> None:
    """Draw one frame: the image, and below it the bird's-eye view, with points, prompts, boxes, truth."""
    from boxlift_client.pictures import (
        draw_labels_on_disk,
        draw_new_labels,
        write_frame_recording,
        write_picture,
    )

    if (rerun or watch) and pred is None:
        raise OptionsError("pred", "there are no labels to show.", "Give --pred LABELS.")
    if watch and pred is not None:
        from boxlift_client.watching import watch_label_set

        with suppress(KeyboardInterrupt):
            # At once, also into a pipe: whoever reads it waits for the next frame.
            watch_label_set(source, pred, out, gt, on_drawn=partial(print, flush=True))
        return
    if frame is None:
        raise OptionsError("FRAME", "no frame is named.", "Name one, or give --watch.")
    if rerun and pred is not None:
        write_frame_recording(out, source, frame, pred)
        print(out)
        return
    if pred is not None:
        picture = draw_labels_on_disk(source, frame, pred, gt)
    else:
        settings = with_detection(preset(preset_name), prompts, detector, min_score)
        if priors is not None:
            settings = settings.with_sizes(read_size_priors(priors))
        picture = draw_new_labels(source, frame, prompts, gt, settings, detector)
    write_picture(out, picture)
    print(out)
