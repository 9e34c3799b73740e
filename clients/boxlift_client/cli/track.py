"""`boxlift track`: what many frames of a drive know that one does not."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from boxlift.storage import open_path
from boxlift_client.shard import parse_shard

if TYPE_CHECKING:
    from boxlift_client.tracking import TrackJob

# Where a tracked label set is, within the one that it was made from.
TRACKED = "tracked"


def track(
    labels: Annotated[
        str, typer.Argument(metavar="LABELS", help="What `boxlift label` wrote.", show_default=False)
    ],
    out: Annotated[
        str | None,
        typer.Option(
            metavar="DIR",
            help="Folder of the tracked label set. Drives that it has are not tracked again.  "
            f"[default: LABELS/{TRACKED}]",
            show_default=False,
        ),
    ] = None,
    source: Annotated[
        str | None,
        typer.Option(
            metavar="DATASET", help="The data set, where it is not where it was labelled.", show_default=False
        ),
    ] = None,
    poses: Annotated[
        Literal["matched", "dataset"],
        typer.Option(
            help="Where sweeps were taken: found by matching them (KISS-ICP), near the data set's poses if "
            "it has any; or as the data set says."
        ),
    ] = "matched",
    fill: Annotated[
        Literal["none", "gaps", "view"],
        typer.Option(
            help="Frames without a prompt that get the box of an object if points lie on it: none, those "
            "between two in which it was labelled, or all that have it in view."
        ),
    ] = "gaps",
    workers: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Drives at a time.  [default: by cores]")
    ] = None,
    shard_name: Annotated[
        str | None,
        typer.Option(
            "--shard", metavar="I/N", help="Track the I-th of N parts of the drives, as in boxlift label."
        ),
    ] = None,
) -> None:
    """Track the objects of every drive of a label set, and give every frame what all of them know.

    Writes a label set of its own, with track ids, and OUT/tracks/DRIVE.json for every drive that is done:
    the same command goes on where it was killed. LABELS stays as it is. Exits with 1 where drives failed.
    """
    from boxlift_client.tracking import TrackJob

    folder = open_path(labels)
    job = TrackJob(
        folder,
        folder / TRACKED if out is None else open_path(out),
        None if source is None else open_path(source),
        poses,
        fill,
    )
    run_tracking(job, workers, shard_name)


def run_tracking(job: TrackJob, workers: int | None, shard_name: str | None) -> None:
    """Track with a progress bar, and print what came of it."""
    from boxlift_client.cli.interruption import resumable
    from boxlift_client.cli.progress import progress_bar
    from boxlift_client.tracking import one_thread, track_label_set

    shard = None if shard_name is None else parse_shard(shard_name)
    count = len(os.sched_getaffinity(0)) if workers is None else workers
    one_thread()
    with resumable(str(job.out)), progress_bar("Tracking") as progress:
        summary = track_label_set(job, progress, workers=count, shard=shard)
    print(summary.text())
    print(f"Labels are in {job.out / 'data'}, details in {job.out / 'details'}.")
    if not summary.complete:
        raise typer.Exit(1)
