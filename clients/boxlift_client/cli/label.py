"""`boxlift label`: a dataset in, 3D labels out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from boxlift.datasets.frames_file import read_frames
from boxlift.errors import DatasetError, OptionsError
from boxlift.formats.size_priors import read_size_priors
from boxlift.settings import DEFAULT_PRESET, PRESETS, LabellerSettings, preset
from boxlift.storage import is_folder, open_path
from boxlift_client.cli.detection import DetectorOption, MinScoreOption, with_detection
from boxlift_client.cli.track import TRACKED, run_tracking
from boxlift_client.job import DETECTOR
from boxlift_client.shard import parse_shard

if TYPE_CHECKING:
    from boxlift.storage import AnyPath
    from boxlift_client.engines import Engine


def label(
    source: Annotated[
        str,
        typer.Argument(
            help="Dataset root (KITTI object: the folder that holds training/), or a folder with velodyne/ "
            "and calib/; here, or as s3://BUCKET/FOLDER.",
            metavar="SOURCE",
            show_default=False,
        ),
    ],
    out: Annotated[
        str,
        typer.Option(
            metavar="DIR",
            help="Folder of the label set, here or as s3://BUCKET/FOLDER. Frames that it has are not "
            "labelled again.",
            show_default=False,
        ),
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
        str | None,
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
        Literal["local", "http", "ray"],
        typer.Option(help="Processes on this machine, boxlift services, or a Ray cluster."),
    ] = "local",
    url: Annotated[
        list[str] | None,
        typer.Option(
            metavar="URL",
            help="A service of --engine http; give it once for each.  [default: http://127.0.0.1:8000]",
        ),
    ] = None,
    ray_address: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="The cluster of --engine ray: auto, or HOST:PORT.  [default: RAY_ADDRESS, else one here]",
        ),
    ] = None,
    frames: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="File with the frames to label, one a line.  [default: all]"),
    ] = None,
    shard_name: Annotated[
        str | None,
        typer.Option(
            "--shard",
            metavar="I/N",
            help="Label the I-th of N parts of the frames, I from 0. auto: as a SLURM array says; auto/N: as "
            "a Kubernetes indexed job says.",
        ),
    ] = None,
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="Try frames again that failed in earlier runs.")
    ] = False,
    frame_timeout_s: Annotated[
        float | None,
        typer.Option(
            "--frame-timeout",
            min=0.1,
            metavar="SECONDS",
            help="A frame that takes longer has failed.  [default: 50 times the median frame, at least 10]",
        ),
    ] = None,
    sequence: Annotated[
        bool,
        typer.Option(
            "--sequence",
            help=f"The frames follow each other: track their objects afterwards, into OUT/{TRACKED} (see "
            "boxlift track).",
        ),
    ] = False,
    workers: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Processes, or requests at a time.  [default: by cores, or 4]"),
    ] = None,
) -> None:
    """Label every frame of a dataset that the label set does not have yet.

    Writes OUT/data/STEM.txt (KITTI result format) and OUT/details/STEM.json (what became of every
    prompt), and a row for every frame into OUT/ledger/: the same command goes on where it was killed.
    Exits with 1 where frames failed (they are in OUT/failed.csv); frames without LiDAR are skipped:
    their files hold no box.
    """
    from boxlift_client.cli.interruption import resumable
    from boxlift_client.cli.progress import progress_bar
    from boxlift_client.job import LabelJob
    from boxlift_client.runner import label_dataset
    from boxlift_client.tracking import TrackJob

    settings = with_detection(_settings(preset_name, size), prompts, detector, min_score)
    if priors is not None:
        settings = settings.with_sizes(read_size_priors(priors))
    if detector is not None and engine == "http":
        raise OptionsError(
            "detector", "the service has its own;", "give it to boxlift serve, or use --engine local."
        )
    root, folder = open_path(source), open_path(out)
    if masks is not None and prompts == DETECTOR:
        raise OptionsError("masks", "masks number prompts that are given;", "give --prompts too.")
    masks_folder = None if masks is None else _find_masks(masks, root)
    job = LabelJob(root, folder, prompts, masks_folder, settings, detector, frame_timeout_s)
    chosen_engine = _engine(engine, url, ray_address, workers)
    names = None if frames is None else read_frames(frames)
    shard = None if shard_name is None else parse_shard(shard_name)
    if sequence and shard is not None:
        raise OptionsError(
            "sequence", "a part of the frames is no drive.", "Give boxlift track when all parts are labelled."
        )
    with resumable(out), progress_bar("Labelling") as progress:
        summary = label_dataset(job, chosen_engine, names, progress, shard=shard, retry_failed=retry_failed)
    print(summary.text())
    print(f"Labels are in {folder / 'data'}, details in {folder / 'details'}.")
    if sequence:
        run_tracking(TrackJob(folder, folder / TRACKED), workers, None)
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


def _engine(name: str, urls: list[str] | None, ray_address: str | None, workers: int | None) -> Engine:
    for option, given, engine in (
        ("url", ", ".join(urls or ()), "http"),
        ("ray_address", ray_address, "ray"),
    ):
        if given and name != engine:
            raise OptionsError(option, f"{given!r} is given to the {name} engine.", f"Add --engine {engine}.")
    if name == "http":
        from boxlift_client.client import DEFAULT_URL
        from boxlift_client.engines.http import HttpEngine

        return HttpEngine(urls or [DEFAULT_URL], workers)
    if name == "ray":
        from boxlift_client.engines.ray import RayEngine

        return RayEngine(workers, address=ray_address)
    from boxlift_client.engines.local import LocalEngine

    return LocalEngine(workers)


def _find_masks(masks: str, source: AnyPath) -> AnyPath:
    """The folder of masks: as a path, or inside the source, as prompts are found."""
    from boxlift.datasets import open_source

    for folder in (open_source(source).root / masks, open_path(masks)):
        if is_folder(folder):
            return folder
    raise DatasetError(
        str(masks), f"there is no such folder, neither in {source} nor from here.", "Check the path."
    )
