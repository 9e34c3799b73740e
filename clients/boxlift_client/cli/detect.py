"""`boxlift detect`: images in, 3D boxes out, without LiDAR."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from boxlift.datasets.frames_file import read_frames
from boxlift.errors import OptionsError

if TYPE_CHECKING:
    from boxlift_client.engines import DetectEngine

_INTERRUPTED = 130  # as shells count: 128 + SIGINT


def detect(
    images: Annotated[
        Path,
        typer.Argument(
            help="An image, a folder of images, or a folder that holds image_2/ (KITTI object: the one that "
            "holds training/).",
            metavar="IMAGES",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder for data/ and details/.", show_default=False)
    ],
    calib: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE|DIR",
            help="The camera: a KITTI or JSON calibration for all images, or a folder with STEM.txt or "
            "STEM.json for each.  [default: calib/ or calib.txt beside image_2/]",
        ),
    ] = None,
    prompts: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|DIR",
            help="2D boxes to lift: label_2 (beside image_2/), or any folder of KITTI text files.  "
            "[default: the objects are found]",
        ),
    ] = None,
    model: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="ONNX file of a monocular model of your own.", show_default=False),
    ] = None,
    min_score: Annotated[
        float, typer.Option(min=0, max=1, metavar="SCORE", help="Least score of objects that are found.")
    ] = 0.0,
    engine: Annotated[
        Literal["local", "http"], typer.Option(help="This process, or a boxlift service.")
    ] = "local",
    url: Annotated[
        str | None,
        typer.Option(metavar="URL", help="The service of --engine http.  [default: http://127.0.0.1:8000]"),
    ] = None,
    frames: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="File with the images to take, a stem a line.  [default: all]"),
    ] = None,
    threads: Annotated[
        int | None,
        typer.Option(
            min=1, max=256, metavar="N", help="CPU threads of the model.  [default: by cores, at most 4]"
        ),
    ] = None,
) -> None:
    """Find the objects of images and their 3D boxes, from the images alone.

    Writes OUT/data/STEM.txt (KITTI result format) and OUT/details/STEM.json (what became of every
    object). Exits with 1 where images failed.
    """
    from boxlift_client.cli.progress import progress_bar
    from boxlift_client.detect_job import DetectJob
    from boxlift_client.runner import detect_images

    chosen_engine = _engine(engine, url, model, threads)
    job = DetectJob(images, out, calib, prompts, min_score)
    names = None if frames is None else read_frames(frames)
    try:
        with progress_bar("Detecting") as progress:
            summary = detect_images(job, chosen_engine, names, progress)
    except KeyboardInterrupt:
        print(f"Interrupted. The images that were finished are in {out}.", file=sys.stderr)
        raise typer.Exit(_INTERRUPTED) from None
    print(summary.text())
    print(f"Labels are in {out / 'data'}, details in {out / 'details'}.")
    if not summary.complete:
        raise typer.Exit(1)


def _engine(name: str, url: str | None, model: Path | None, threads: int | None) -> DetectEngine:
    from boxlift_client.client import DEFAULT_URL
    from boxlift_client.engines.detection import HttpDetectEngine, LocalDetectEngine

    if name == "local":
        if url is not None:
            raise OptionsError("url", f"{url!r} is given to the local engine.", "Add --engine http.")
        return LocalDetectEngine(model, threads)
    for option, given in (("model", model), ("threads", threads)):
        if given is not None:
            raise OptionsError(option, "the service has its own;", "leave it out, or use --engine local.")
    return HttpDetectEngine(url or DEFAULT_URL)
