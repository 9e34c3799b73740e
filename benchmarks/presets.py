"""Recall of each preset on a labelled dataset, and box against mask prompts on generated scenes.

    python benchmarks/presets.py [FOLDER] [--generated 40]

FOLDER is a dataset in KITTI object layout with label_2 (by default ../shared/kitti/object where it exists).
Prompts are the 2D boxes of its labels. Recall counts a truth as found by the box of its own prompt;
at the loose (l) and the strict (s) IoU of the class: .5 and .7 for vehicles, .25 and .5 for people.
Drives differ more than seeds do, so the table is split by drive where frames.csv names them.
"""

from __future__ import annotations

import argparse
import csv
import tempfile
from collections.abc import Sequence
from pathlib import Path

import torch

from boxlift.datasets import open_source
from boxlift.datasets.generated import RIGS, generate, write_dataset
from boxlift.evaluation import evaluate_folders
from boxlift.settings import PRESETS
from boxlift_client.engines.local import LocalEngine
from boxlift_client.job import LabelJob
from boxlift_client.runner import label_dataset

DEFAULT_FOLDER = Path(__file__).resolve().parents[2] / "shared" / "kitti" / "object"
_COLUMNS = ("bev@l", "bev@s", " 3d@l", " 3d@s")


def print_recall(
    title: str, gt: Path, pred: Path, frames: Sequence[str], classes: Sequence[str] = ("Car",)
) -> None:
    """One line per class and difficulty."""
    evaluation = evaluate_folders(gt, pred, frames, pseudo_label_classes=tuple(classes))
    for category in classes:
        for row in evaluation.pseudo_labels[category][:3]:
            strict, loose = sorted(row.at_iou, key=lambda at: -at.iou)
            values = (loose.recall_bev, strict.recall_bev, loose.recall_3d, strict.recall_3d)
            cells = "  ".join("   -" if value is None else f"{value:.2f}" for value in values)
            print(f"{title:34} {category:10} {row.group:9} {row.truths:5d}  {cells}")


def label(root: Path, out: Path, preset: str, masks: str | None = None) -> list[str]:
    """Label a dataset with the prompts of its labels; the names of the frames that have LiDAR."""
    folder = None if masks is None else root / "training" / masks
    job = LabelJob(source=root, out=out, prompts="label_2", masks=folder, settings=PRESETS[preset])
    unlabelled = {report.frame for report in label_dataset(job, LocalEngine(workers=2)).unlabelled}
    return [name for name in open_source(root).names if name not in unlabelled]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--generated", type=int, default=40, help="generated frames per rig")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    folder = arguments.folder or (DEFAULT_FOLDER if DEFAULT_FOLDER.is_dir() else None)

    header = "  ".join(_COLUMNS)
    print(f"{'recall':34} {'class':10} {'group':9} {'truths':>5}  {header}")
    with tempfile.TemporaryDirectory() as scratch:
        if folder is not None:
            truth = folder / "training" / "label_2"
            for preset in sorted(PRESETS):
                out = Path(scratch) / preset
                frames = label(folder, out, preset)
                print_recall(f"{preset}, all drives", truth, out, frames)
                for drive, names in drives_of(folder, frames).items():
                    print_recall(f"{preset}, {drive}", truth, out, names)
        for rig in ("kitti", "roof32") if arguments.generated else ():
            root = Path(scratch) / rig
            write_dataset(root, (generate(seed, RIGS[rig]) for seed in range(arguments.generated)))
            for preset in sorted(PRESETS):
                for prompts, masks in (("boxes", None), ("masks", "masks")):
                    out = Path(scratch) / f"{rig}-{preset}-{prompts}"
                    frames = label(root, out, preset, masks)
                    print_recall(
                        f"{preset}, generated {rig}, {prompts}",
                        root / "training" / "label_2",
                        out,
                        frames,
                        ("Car", "Van", "Truck", "Pedestrian", "Cyclist"),
                    )


def drive_of_frames(folder: Path) -> dict[str, str]:
    """Frame -> drive, where frames.csv tells drives; else nothing."""
    table = folder / "frames.csv"
    if not table.is_file():
        return {}
    with table.open(newline="") as lines:
        return {row["frame"]: row["raw_drive"].removesuffix("_sync") for row in csv.DictReader(lines)}


def drives_of(folder: Path, frames: Sequence[str]) -> dict[str, list[str]]:
    """The frames of the largest drive and of all others, where frames.csv tells drives; else nothing."""
    drive_of = drive_of_frames(folder)
    if not drive_of:
        return {}
    drives = [drive_of[name] for name in frames]
    largest = max(sorted(set(drives)), key=drives.count)
    return {
        largest: [n for n in frames if drive_of[n] == largest],
        "all other drives": [n for n in frames if drive_of[n] != largest],
    }


if __name__ == "__main__":
    main()
