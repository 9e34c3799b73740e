"""What each part of a method is worth: recall of cars with parts of it switched off.

    python benchmarks/ablation.py [FOLDER] [--part paper|descent|accurate] [--generated 24]

FOLDER is a dataset with label_2 (by default ../shared/kitti/object where it exists); prompts are the 2D boxes
of its labels. Cells are recall in %, BEV/3D, at an IoU of .5 and then of .7.

The rows of the paper's ablations (see weakm3d_tables.py) with two fits, and our own:

- Part "paper": the labeller's search; where heading and size are free (no D), the lowest of eight descents
  whose headings are evenly turned from a random one, as then none is read from the points.
- Part "descent": one descent, as training a network is. It starts at the mean of the points with the frozen
  size and the heading read from the points, also where these are free.
- Part "accurate": the preset `accurate` with each of its repairs switched off alone.

The centre loss stays in every row, as in the paper. Its numbers are the average precision of a network, ours
the recall of boxes that minimise the same losses: only the order of the rows can be compared.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import torch

from boxlift import Frame, FrameLabels, InputError, LabellerSettings, preset
from boxlift.camera import Floats
from boxlift.datasets import load_objects, open_source
from boxlift.datasets.generated import RIGS, generate
from boxlift.evaluation import DIFFICULTIES, LabelTable, judge_pseudo_labels
from boxlift.faithful import fit_problems
from boxlift.formats.kitti_label import KittiObject, objects_of, prompts_of
from boxlift.labeller import Labeller
from freed_fit import Freed, freed_labels
from presets import DEFAULT_FOLDER, drives_of
from row_order import kendall_tau, print_effects, print_pairs
from weakm3d_tables import DETAILED, SIZE_LEARNED

UNREAD = Freed(size=True, heading=True, heading_read=False)


@dataclass(frozen=True)
class Row:
    """A name, the options laid over the preset, and the paper's AP (BEV, then 3D: easy, moderate, hard).

    freed: None for the labeller's own fit, else the descent that takes its place.
    """

    name: str
    options: dict[str, object]
    freed: Freed | None = None
    paper: tuple[float, ...] = ()


@dataclass(frozen=True)
class Recall:
    """Of one group and difficulty: the number of cars, and recall BEV@.5, 3D@.5, BEV@.7, 3D@.7."""

    cars: int
    values: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Dataset:
    """Frames whose prompts are the 2D boxes of their truths; groups of frames, the first one all of them."""

    title: str
    frames: Sequence[Frame]
    truths: Mapping[str, Sequence[KittiObject]]
    groups: Mapping[str, Sequence[str]]


def _with_parts(parts: str) -> dict[str, object]:
    on = {part: float(part in parts) for part in "GRB"}
    loss = {"geometric_weight": on["G"], "ray_weight": on["R"], "balance_by_density": on["B"]}
    return {"loss": loss}


def paper_rows() -> list[Row]:
    """The paper's rows, then some that it lacks."""
    full = _with_parts("GRB")
    return [
        *(
            Row(name, _with_parts(name[1:]), None if "D" in name else UNREAD, paper)
            for name, paper in DETAILED.items()
        ),
        Row("p, size free", full, Freed(size=True), SIZE_LEARNED),
        Row("p, heading free", full, Freed(heading=True)),
        Row("p, heading free, not read", full, Freed(heading=True, heading_read=False)),
        Row("p, without centre loss", {"loss": {"center_weight": 0.0}}),
    ]


def descent_rows() -> list[Row]:
    """The paper's rows by one descent each, from the mean of the points and the heading read from them."""
    return [
        *(
            Row(
                name, _with_parts(name[1:]), Freed() if "D" in name else Freed(size=True, heading=True), paper
            )
            for name, paper in DETAILED.items()
        ),
        Row("p, size free", _with_parts("GRB"), Freed(size=True), SIZE_LEARNED),
    ]


def accurate_rows() -> list[Row]:
    """The preset as it is, then each repair switched off alone."""
    off: dict[str, dict[str, object]] = {
        "points not claimed": {"claim": False},
        "one cluster scale": {"cluster_scales": [1.0]},
        "largest cluster only": {"max_clusters": 1},
        "no closeness": {"closeness": False},
        "no perpendicular": {"perpendicular": False},
        "no placement by prompt": {"prompt_placement": False},
        "2 fits": {"fits": 2},
        "6 fits": {"fits": 6},
        "12 fits": {"fits": 12},
        "chosen by loss": {"choose": "loss"},
        "edges not compared": {"edges": False},
        "boxes may overlap": {"exclusion_weight": 0.0},
        "no polish": {"polish": False},
        "size fixed": {"size": "fixed"},
    }
    return [
        Row("all repairs", {}),
        Row("ground plane", {"ground": {"shape": "plane"}}),
        *(Row(name, {"repairs": options}) for name, options in off.items()),
    ]


# Part -> its preset, and rows of options laid over it. Rows without the paper's numbers are only printed.
PARTS = {
    "paper": ("paper", paper_rows()),
    "descent": ("paper", descent_rows()),
    "accurate": ("accurate", accurate_rows()),
}


def recall_of(
    settings: LabellerSettings, data: Dataset, freed: Freed | None = None
) -> dict[str, list[Recall]]:
    """Group -> recall of easy, moderate and hard cars."""
    labels = _labels(settings.model_dump_json(), data)
    if freed:
        problems = [fit_problems(frame, settings) for frame in data.frames]
        labels = freed_labels(data.frames, labels, problems, settings, freed, "Car")
    boxes = {label.frame_name: objects_of(label) for label in labels}
    rows = {}
    for group, names in data.groups.items():
        truths, predictions = (
            LabelTable.from_frames(some[n] for n in names) for some in (data.truths, boxes)
        )
        rows[group] = [
            Recall(
                quality.truths,
                tuple(
                    value or 0.0
                    for at in sorted(quality.at_iou, key=lambda at: at.iou)
                    for value in (at.recall_bev, at.recall_3d)
                ),
            )
            for quality in judge_pseudo_labels(truths, predictions, "Car")[: len(DIFFICULTIES)]
        ]
    return rows


@cache
def _labels(settings_json: str, data: Dataset) -> list[FrameLabels]:
    """The labels of every frame; settings as JSON, as they cannot be hashed."""
    labeller = Labeller(LabellerSettings.model_validate_json(settings_json))
    return [labeller.label(frame) for frame in data.frames]


def kitti(folder: Path) -> Dataset:
    """The frames that have LiDAR, grouped into the largest drive and all others where these are named."""
    source = open_source(folder)
    frames, truths = [], {}
    for name in source.names:
        truths[name] = load_objects("label_2", source, name)
        try:
            frames.append(source.load(name, prompts_of(truths[name])))
        except InputError as error:
            print(f"left out: {error}")
    names = [frame.name for frame in frames]
    groups = {"all frames": names, **drives_of(folder, names)}
    return Dataset(f"{len(frames)} frames of {folder}", frames, truths, groups)


def generated(count: int, rig: str = "kitti", first_seed: int = 0) -> Dataset:
    """Generated frames, and both halves of them."""
    made = [generate(first_seed + number, RIGS[rig]) for number in range(count)]
    names = [item.frame.name for item in made]
    groups = {"all frames": names, "even seeds": names[::2], "odd seeds": names[1::2]}
    truths = {item.frame.name: item.truth for item in made}
    return Dataset(f"{count} generated frames, rig {rig}", [item.frame for item in made], truths, groups)


Measured = Mapping[str, Mapping[str, Sequence[Recall]]]


def print_table(rows: Sequence[Row], measured: Measured, group: str) -> None:
    """A line per row: recall of the three difficulties, and the paper's AP."""
    cars = [recall.cars for recall in measured[rows[0].name][group]]
    heads = [f"{d.name}, {n} cars".ljust(17) for d, n in zip(DIFFICULTIES, cars, strict=True)]
    paper_head = "the paper's AP at .5" if any(row.paper for row in rows) else ""
    print(f"\n{group:28} {' '.join(heads)} {paper_head}".rstrip())
    for row in rows:
        cells = [
            "{:3.0f}/{:3.0f} {:3.0f}/{:3.0f}  ".format(*(100 * value for value in recall.values))
            for recall in measured[row.name][group]
        ]
        paper = [f"{b:4.1f}/{v:4.1f}" for b, v in zip(row.paper[:3], row.paper[3:], strict=True)]
        print(f"{row.name:28} {' '.join(cells)} {'  '.join(paper)}".rstrip())


def print_agreement(rows: Sequence[Row], measured: Measured, groups: Sequence[str]) -> None:
    """Where the order of the rows is the paper's, and where it is not."""
    rows = [row for row in rows if row.paper]
    paper = np.array([row.paper for row in rows]).T
    print("\nOrder of the rows against the paper's, IoU .5: Kendall's tau-a")
    ours: dict[tuple[str, str], dict[str, Floats]] = {}
    for column, (metric, level) in enumerate(product(("BEV", "3D"), DIFFICULTIES)):
        ours[metric, level.name] = {
            group: np.array([measured[row.name][group][column % 3].values[column // 3] for row in rows])
            for group in groups
        }
        taus = [
            f"{group} {kendall_tau(values, paper[column]):.2f}"
            for group, values in ours[metric, level.name].items()
        ]
        print(f"    {metric:3} {level.name:8} {', '.join(taus)}")
    for metric, column in (("BEV", 1), ("3D", 4)):
        columns = ours[metric, "moderate"]
        print()
        print_pairs(f"moderate {metric}@.5", [row.name for row in rows], columns, paper[column])
        switched = [index for index, row in enumerate(rows) if row.name in DETAILED]
        print_effects(
            f"moderate {metric}@.5",
            [rows[index].name[2:] for index in switched],
            {group: values[switched] for group, values in columns.items()},
            paper[column][switched],
        )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--part", choices=PARTS, help="only one part")
    parser.add_argument("--generated", type=int, default=24, help="generated frames; 0: none")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    folder = arguments.folder or (DEFAULT_FOLDER if DEFAULT_FOLDER.is_dir() else None)

    datasets = [kitti(folder)] if folder else []
    if arguments.generated:
        datasets.append(generated(arguments.generated))
    for data in datasets:
        for part in [arguments.part] if arguments.part else PARTS:
            base, rows = PARTS[part]
            print(f"\n== Part {part!r}, preset {base}: {data.title}")
            measured = {
                row.name: recall_of(preset(base).with_options(row.options), data, row.freed) for row in rows
            }
            for group in data.groups:
                print_table(rows, measured, group)
            if any(row.paper for row in rows):
                print_agreement(rows, measured, list(data.groups))


if __name__ == "__main__":
    main()
