"""Frames of KITTI's tracking benchmark as a Dataset: `accurate.py --sequences`.

Beside the object folder lie weak/ (frames) and sequences/NNNN/{label_02.txt, frames.csv} (their labels, and
which raw frame is which file). Source of the format: the readme of the KITTI tracking development kit.
The frames follow each other closely, so that the same few objects are counted many times.
"""

from __future__ import annotations

import csv
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

from ablation import Dataset
from boxlift.datasets import open_source
from boxlift.formats.kitti_label import KittiObject, parse_line, prompts_of

# Tracking labels tell truncation in three levels: of the object benchmark, those that count as moderate and
# as not at all (ours: the levels have no published shares).
_TRUNCATED = {0: 0.0, 1: 0.25, 2: 0.6}


def tracking_objects(path: Path) -> dict[int, list[KittiObject]]:
    """Raw frame -> its objects; the lines begin with frame and track, then go on as those of label_2."""
    found: dict[int, list[KittiObject]] = defaultdict(list)
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        frame, _, *columns = line.split()
        item = parse_line(" ".join(columns), f"{path}:{number}")
        found[int(frame)].append(replace(item, truncated=_TRUNCATED.get(int(item.truncated), -1.0)))
    return found


def sequence(weak: Path, labels: Path) -> Dataset:
    """The frames of a sequence that lie in `weak`, with the labels of `labels`."""
    source = open_source(weak)
    objects = tracking_objects(labels / "label_02.txt")
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
