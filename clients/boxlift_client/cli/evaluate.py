"""`boxlift evaluate`: labels against the truth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal

import typer

from boxlift.datasets.frames_file import read_frames
from boxlift.errors import OptionsError
from boxlift.storage import open_path


def evaluate(
    gt: Annotated[
        str,
        typer.Option(
            metavar="DIR|FILE",
            help="The truth: a folder of KITTI label files STEM.txt; for waymo and nuscenes also label sets, "
            "Argoverse 2 tables, nuScenes results files and data sets with 3D annotations.",
            show_default=False,
        ),
    ],
    pred: Annotated[
        str,
        typer.Option(
            metavar="DIR|FILE",
            help="What `boxlift label` wrote: its folder, or its data/; or as --gt.",
            show_default=False,
        ),
    ],
    frames: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="File with the frames (for waymo and nuscenes: sweeps) to judge, one a line.  "
            "[default: all of --gt]",
        ),
    ] = None,
    metric: Annotated[
        Literal["kitti", "waymo", "nuscenes"], typer.Option(help="Whose rules: see docs/metrics.md.")
    ] = "kitti",
    iou: Annotated[
        float | None,
        typer.Option(help="waymo: from which IoU on a box is right.  [default: 0.5]", show_default=False),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
) -> None:
    """Judge labels: average precision by the rules of KITTI, Waymo or nuScenes; for KITTI also how well each
    prompt was lifted."""
    if iou is not None and metric != "waymo":
        raise OptionsError("iou", f"the metric {metric} has its own.", "Leave --iou out.")
    names = None if frames is None else read_frames(frames)
    truth_path, found_path = open_path(gt), open_path(pred)
    if metric == "kitti":
        from boxlift.evaluation import evaluate_folders

        evaluation = evaluate_folders(truth_path, found_path, names)
        print(json.dumps(evaluation.to_json(), indent=2) if as_json else evaluation.to_table())
        return

    from boxlift import evaluation as rules
    from boxlift_client.sweep_files import read_truth_and_predictions

    truth, found = read_truth_and_predictions(truth_path, found_path, names)
    if metric == "waymo":
        waymo = rules.judge_like_waymo(truth, found, rules.DEFAULT_IOU if iou is None else iou)
        print(json.dumps(rules.waymo_json(waymo), indent=2) if as_json else rules.waymo_table(waymo))
    else:
        nuscenes = rules.judge_like_nuscenes(truth, found)
        print(
            json.dumps(rules.nuscenes_json(nuscenes), indent=2) if as_json else rules.nuscenes_table(nuscenes)
        )
