"""`boxlift label`: a dataset in, 3D labels out."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from boxlift.datasets.frames_file import read_frames
from boxlift.errors import DatasetError, OptionsError
from boxlift.formats.size_priors import read_size_priors
from boxlift.settings import DEFAULT_PRESET, PRESETS, LabellerSettings, preset
from boxlift_client.cli.detection import DetectorOption, MinScoreOption, with_detection
from boxlift_client.job import DETECTOR

if TYPE_CHECKING:
    from boxlift_client.engines import Engine

_INTERRUPTED = 130  # as shells count: 128 + SIGINT


def label(
    source: Annotated[
        Path,
        typer.Argument(
            help="Dataset root (KITTI object: the folder that holds training/), or a folder with velodyne/ "
            "and calib/.",
            metavar="SOURCE",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder for data/ and details/.", show_default=False)
    ],
    prompts: Annotated[
        str,
        typer.Option(
            metavar="NAME|DIR",
            help="2D boxes: label_2 or det_2d (in the source), or any folder of KITTI text files. "
            "detector: found in each image.",
        ),
    ] = DETECTOR,
    detector: DetectorOption = None,
    min_score: MinScoreOption = None,
    masks: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder of instance masks STEM.png: pixel = prompt index + 1 (without DontCare), 0 = none.",
        ),
    ] = None,
    preset_name: Annotated[
        str, typer.Option("--preset", metavar="NAME", help=f"Settings of the labeller: {', '.join(PRESETS)}.")
    ] = DEFAULT_PRESET,
    size: Annotated[
        Literal["refined", "fixed"] | None,
        typer.Option(
            help="Refine each box's size, or keep the frozen size of its class.  "
            "[default: refined by accurate, fixed by paper and release]"
        ),
    ] = None,
    priors: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="TOML file with sizes per class, laid over the built-in ones."),
    ] = None,
    engine: Annotated[
        Literal["local", "http"], typer.Option(help="Processes on this machine, or a boxlift service.")
    ] = "local",
    url: Annotated[
        str | None,
        typer.Option(metavar="URL", help="The service of --engine http.  [default: http://127.0.0.1:8000]"),
    ] = None,
    frames: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="File with the frames to label, one a line.  [default: all]"),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Processes, or requests at a time.  [default: by cores, or 4]"),
    ] = None,
) -> None:
    """Label every frame of a dataset.

    Writes OUT/data/STEM.txt (KITTI result format) and OUT/details/STEM.json (what became of every
    prompt). Exits with 1 where frames failed; frames without LiDAR are skipped: their files hold no box.
    """
    from boxlift_client.cli.progress import progress_bar
    from boxlift_client.job import LabelJob
    from boxlift_client.runner import label_dataset

    settings = with_detection(_settings(preset_name, size), prompts, detector, min_score)
    if priors is not None:
        settings = settings.with_sizes(read_size_priors(priors))
    if detector is not None and engine == "http":
        raise OptionsError(
            "detector", "the service has its own;", "give it to boxlift serve, or use --engine local."
        )
    if masks is not None:
        if prompts == DETECTOR:
            raise OptionsError("masks", "masks number prompts that are given;", "give --prompts too.")
        masks = _find_masks(masks, source)
    job = LabelJob(source, out, prompts, masks, settings, detector)
    chosen_engine = _engine(engine, url, workers)
    names = None if frames is None else read_frames(frames)
    try:
        with progress_bar("Labelling") as progress:
            summary = label_dataset(job, chosen_engine, names, progress)
    except KeyboardInterrupt:
        print(f"Interrupted. The frames that were finished are in {out}.", file=sys.stderr)
        raise typer.Exit(_INTERRUPTED) from None
    print(summary.text())
    print(f"Labels are in {out / 'data'}, details in {out / 'details'}.")
    if not summary.complete:
        raise typer.Exit(1)


def _settings(preset_name: str, size: str | None) -> LabellerSettings:
    settings = preset(preset_name)
    if size is None or (size == "fixed" and settings.repairs is None):
        return settings
    if settings.repairs is None:
        raise OptionsError(
            "size", f"{size!r} does not go with preset {preset_name!r};", "sizes are refined by accurate."
        )
    return settings.with_options({"repairs": {"size": size}})


def _engine(name: str, url: str | None, workers: int | None) -> Engine:
    if name == "http":
        from boxlift_client.client import DEFAULT_URL
        from boxlift_client.engines.http import HttpEngine

        return HttpEngine(url or DEFAULT_URL, workers)
    from boxlift_client.engines.local import LocalEngine

    if url is not None:
        raise OptionsError("url", f"{url!r} is given to the local engine.", "Add --engine http.")
    return LocalEngine(workers)


def _find_masks(masks: Path, source: Path) -> Path:
    """The folder of masks: as a path, or inside the source, as prompts are found."""
    from boxlift.datasets import open_source

    for folder in (open_source(source).root / masks, masks):
        if folder.is_dir():
            return folder
    raise DatasetError(
        str(masks), f"there is no such folder, neither in {source} nor from here.", "Check the path."
    )
