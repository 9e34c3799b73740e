"""Everything that the trainings of the monocular model read: 2D boxes, folds, and a config per run.

    python benchmarks/monocular_runs.py KITTI --out RUNS      (KITTI: the folder that holds object/ and weak/)

Folds go by raw drive. A: judged on drive 0009, trained on everything else. B: judged on every labelled drive
but 0009, trained on the frames of drives that are not judged. `all` trains on everything and is what ships.
2D boxes are those of the detector that comes with boxlift. Labels are used to judge, and by the one run that
compares with full supervision.
"""

from __future__ import annotations

import argparse
import csv
from dataclasses import dataclass
from pathlib import Path

from boxlift.datasets import open_source
from boxlift.detector import Detector
from boxlift.formats import image as image_files
from boxlift.formats import kitti_label
from boxlift.formats.kitti_label import UNKNOWN_ANGLE, UNKNOWN_LOCATION, UNKNOWN_SIZE, KittiObject
from boxlift.frame import Prompt
from sequences import objects_by_frame

_FOLD_DRIVE = "_0009_"
SETS = ("object", "weak")


@dataclass(frozen=True)
class KittiFrame:
    """A frame, the set it lies in, its drive, and whether its labels are known."""

    name: str
    part: str
    drive: str
    labelled: bool


def frames_of(kitti: Path) -> list[KittiFrame]:
    """All frames that have an image, by the lists that come with them."""
    found = []
    for part in SETS:
        with (kitti / part / "frames.csv").open(newline="") as lines:
            found += [
                KittiFrame(row["frame"], part, row["raw_drive"], part == "object")
                for row in csv.DictReader(lines)
            ]
    return found


def trained_on(fold: str, frames: list[KittiFrame]) -> list[KittiFrame]:
    """The frames that a fold may train on."""
    judged = {frame.drive for frame in frames if frame.labelled and _FOLD_DRIVE not in frame.drive}
    if fold == "A":
        return [frame for frame in frames if _FOLD_DRIVE not in frame.drive]
    if fold == "B":
        return [frame for frame in frames if frame.drive not in judged]
    return frames


def judged_on(fold: str, frames: list[KittiFrame]) -> list[str]:
    """The frames of object/ that a fold is judged on; those without LiDAR can be judged as well."""
    return [f.name for f in frames if f.labelled and (_FOLD_DRIVE in f.drive) == (fold == "A")]


def source_of(kitti: Path, part: str) -> Path:
    """The folder of a set, as `open_source` takes it."""
    return kitti / part


def write_prompts(kitti: Path, out: Path, frames: list[KittiFrame], min_score: float) -> None:
    """The detector's boxes of every frame: OUT/prompts_PART/NAME.txt; what is there is kept."""
    detector = Detector.open()
    for frame in frames:
        path = out / f"prompts_{frame.part}" / f"{frame.name}.txt"
        if path.exists():
            continue
        folder = open_source(source_of(kitti, frame.part)).root / "image_2"
        image = next(
            folder / f"{frame.name}{s}"
            for s in image_files.SUFFIXES
            if (folder / f"{frame.name}{s}").exists()
        )
        prompts = detector.detect(image_files.decode_image(image, str(image)), min_score).prompts
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(kitti_label.to_text(_line(p) for p in prompts))


def write_sequence_labels(kitti: Path, out: Path) -> dict[str, list[str]]:
    """Labels of frames of weak/ from the tracking benchmark: OUT/labels_weak/NAME.txt; names by sequence."""
    names: dict[str, list[str]] = {}
    (out / "labels_weak").mkdir(parents=True, exist_ok=True)
    for labels in sorted((kitti / "sequences").glob("0*")):
        objects = objects_by_frame(labels / "label_02.txt")
        with (labels / "frames.csv").open(newline="") as lines:
            raw_of = {
                Path(row["files"]).name: int(row["raw_frame"])
                for row in csv.DictReader(lines)
                if Path(row["files"]).parts[0] == "weak"
            }
        for name, raw in raw_of.items():
            (out / "labels_weak" / f"{name}.txt").write_text(kitti_label.to_text(objects.get(raw, [])))
        names[labels.name] = sorted(raw_of)
    return names


_CONFIG = """\
# Written by benchmarks/monocular_runs.py: fold {fold}.
task = "lifter"

[data]
targets = "accurate"
categories = ["Car", "Truck", "Pedestrian", "Cyclist"]
{sets}
[rows]
views = 4
shifts = 1

[model]
blind_voices = 3
seeing_voices = 3

[augmentation]
flip = 0.5
focal = 0.25
scale = 0.2
color = 0.2

[trainer]
epochs = 60
batch_size = 256
learning_rate = 1.5e-3
optimizer = "adamw"
weight_decay = 0.02
schedule = "cosine"
warmup_epochs = 3
evaluate_every = 0
"""
_TRAIN = """
[[data.train]]
source = "{source}"
prompts = "{prompts}"
frames = "train_{fold}_{part}.txt"
"""


def write_config(kitti: Path, out: Path, fold: str) -> None:
    """The training of the head that ships, on a fold: OUT/lifter_FOLD.toml."""
    sets = "".join(
        _TRAIN.format(
            source=source_of(kitti, part).resolve(),
            prompts=(out / f"prompts_{part}").resolve(),
            fold=fold,
            part=part,
        )
        for part in SETS
    )
    (out / f"lifter_{fold}.toml").write_text(_CONFIG.format(fold=fold, sets=sets))


def _line(prompt: Prompt) -> KittiObject:
    return KittiObject(
        prompt.category,
        -1,
        -1,
        UNKNOWN_ANGLE,
        prompt.box_px,
        UNKNOWN_SIZE,
        UNKNOWN_LOCATION,
        UNKNOWN_ANGLE,
        prompt.score,
    )


def main() -> None:
    """Write everything."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("kitti", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--min-score", type=float, default=0.2)
    options = parser.parse_args()
    out: Path = options.out
    out.mkdir(parents=True, exist_ok=True)
    frames = frames_of(options.kitti)
    for fold in ("A", "B", "all"):
        for part in SETS:
            chosen = [frame.name for frame in trained_on(fold, frames) if frame.part == part]
            (out / f"train_{fold}_{part}.txt").write_text("\n".join(chosen) + "\n")
        write_config(options.kitti, out, fold)
        if fold != "all":
            (out / f"judge_{fold}.txt").write_text("\n".join(judged_on(fold, frames)) + "\n")
    for sequence, names in write_sequence_labels(options.kitti, out).items():
        (out / f"judge_sequence_{sequence}.txt").write_text("\n".join(names) + "\n")
    write_prompts(options.kitti, out, frames, options.min_score)


if __name__ == "__main__":
    main()
