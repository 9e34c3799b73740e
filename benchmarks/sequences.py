"""Frames of KITTI's tracking benchmark as a Dataset: `accurate.py --sequences`.

Beside the object folder lie weak/ (frames) and sequences/NNNN/{label_02.txt, frames.csv} (their labels, and
which raw frame is which file). Source of the format: the readme of the KITTI tracking development kit.
The frames follow each other closely, so that the same few objects are counted many times.
"""

from __future__ import annotations

import csv
from pathlib import Path

from ablation import Dataset
from boxlift.datasets import open_source
from boxlift.formats.kitti_label import KittiObject, prompts_of
from boxlift.formats.kitti_tracks import read_tracks


def objects_by_frame(path: Path) -> dict[int, list[KittiObject]]:
    """Raw frame -> its objects, whatever their tracks."""
    return {frame: [each.line for each in tracked] for frame, tracked in read_tracks(path).items()}


def sequence(weak: Path, labels: Path) -> Dataset:
    """The frames of a sequence that lie in `weak`, with the labels of `labels`."""
    source = open_source(weak)
    objects = objects_by_frame(labels / "label_02.txt")
    with (labels / "frames.csv").open(newline="") as lines:
        raw_of = {
            Path(row["files"]).name: int(row["raw_frame"])
            for row in csv.DictReader(lines)
            if Path(row["files"]).parts[0] == weak.name
        }
    truths = {name: objects.get(raw, []) for name, raw in raw_of.items()}
    frames = [source.load(name, prompts_of(own)) for name, own in truths.items()]
    title = f"sequence {labels.name}, {len(frames)} frames of {weak.name}/"
    return Dataset(title, frames, truths, {"all frames": list(truths)})
