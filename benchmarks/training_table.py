"""What supervises best: one table of small trainings of equal size, on frames of drives never trained on.

    python benchmarks/training_table.py [--kitti ../shared/kitti] [--out runs/table] [--epochs 30]
        [--rows points labels ...]

Two folds, as the data's README has them: A judges drive 0009 and trains on all other drives; B judges the
other labelled drives and trains on those that are not judged. 2D boxes are those of the detector in the
package, in training and in judging. Every row trains heads on the frozen NanoDet trunk and is judged on both
folds together, so that every labelled frame (with LiDAR) counts once. Intervals are 90 % of a bootstrap over
frames.
A row that was interrupted goes on when the same command is given again.
"""

from __future__ import annotations

import argparse
import csv
import multiprocessing
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from boxlift.datasets import load_objects, open_source
from boxlift.formats.kitti_label import KittiObject, read_file
from boxlift.network.frozen_maps import KnownMaps

_DEFAULT_KITTI = Path(__file__).resolve().parents[2] / "shared" / "kitti"
_JUDGED_IN_A = "2011_09_26_drive_0009_sync"
_FIGURES = ("bev_0.5", "3d_0.5", "bev_0.3", "3d_0.3")
_RESAMPLES = 200

_BASE: dict[str, Any] = {
    "model.backbone": "nanodet",
    "model.freeze_backbone": True,
    "model.roi_strides": [8],
    "model.hidden": 128,
    "model.depth": "box_height",
    "trainer.evaluate_every": 0,
}
_NO_GEOMETRY = {"loss.alignment.geometric_weight": 0.0}
_NO_RAYS = {"loss.alignment.ray_weight": 0.0}
_NO_BALANCE = {"loss.alignment.balance_by_density": False}
_LABELLED = {"labelled_only": True}
# Name of a row -> what it says in the table, and how it differs from _BASE.
ROWS: dict[str, tuple[str, dict[str, Any]]] = {
    "points": ("direct losses on points (the paper's)", {}),
    "features": ("  depth from features alone, as in the paper", {"model.depth": "features"}),
    "learned": ("  learned dimensions", {"model.sizes": "learned"}),
    "no_geometry": ("  without geometric alignment", _NO_GEOMETRY),
    "no_rays": ("  without ray tracing", _NO_RAYS),
    "no_balance": ("  without balancing", _NO_BALANCE),
    "center_only": ("  centre loss alone", _NO_GEOMETRY | _NO_RAYS | _NO_BALANCE),
    "entangled": (
        "  no disentanglement (sizes learned, own heading)",
        {"model.sizes": "learned", "loss.heading": "predicted"},
    ),
    "pseudo_paper": ("pseudo labels of `paper`", {"data.targets": "paper"}),
    "pseudo_accurate": ("pseudo labels of `accurate`", {"data.targets": "accurate"}),
    "points_labelled": ("direct losses, only frames that have labels", _LABELLED),
    "accurate_labelled": (
        "pseudo labels of `accurate`, only these",
        _LABELLED | {"data.targets": "accurate"},
    ),
    "labels": ("drawn labels, only these (full supervision)", _LABELLED | {"data.targets": "label_2"}),
    "center_points": (
        "CenterNet-style, direct losses",
        {"model.network": "one_stage", "model.hidden": 16, "model.depth": "features"},
    ),
    "center_labels": (
        "CenterNet-style, drawn labels",
        _LABELLED
        | {
            "model.network": "one_stage",
            "model.hidden": 16,
            "model.depth": "features",
            "data.targets": "label_2",
        },
    ),
}


def drives(kitti: Path) -> dict[tuple[str, str], str]:
    """(folder, frame) -> drive."""
    found = {}
    for folder in ("object", "weak"):
        with (kitti / folder / "frames.csv").open(newline="") as file:
            for row in csv.DictReader(file):
                found[folder, row["frame"]] = row["raw_drive"]
    return found


def detect_prompts(kitti: Path, out: Path) -> None:
    """2D boxes of the package's detector in every frame, as KITTI result files."""
    from boxlift.detector import Detector
    from boxlift.formats.image import decode_image
    from boxlift.network.training_frames import find_image

    detector = Detector.open()
    for folder in ("object", "weak"):
        source = open_source(kitti / folder)
        (out / folder).mkdir(parents=True, exist_ok=True)
        for name in source.names:
            path = out / folder / f"{name}.txt"
            if not path.exists():
                image = decode_image(find_image(source, name))
                found = detector.detect(image, 0.3).prompts
                lines = [
                    f"{p.category} -1 -1 -10 {' '.join(f'{edge:.2f}' for edge in p.box_px)} "
                    f"-1 -1 -1 -1000 -1000 -1000 -10 {p.score:.4f}\n"
                    for p in found
                ]
                path.write_text("".join(lines))


def write_folds(kitti: Path, out: Path) -> None:
    """Lists of frames: OUT/A_train_object.txt, A_train_weak.txt, A_judge.txt and the same for B."""
    drive_of = drives(kitti)
    judged = {
        "A": {_JUDGED_IN_A},
        "B": {drive for (folder, _), drive in drive_of.items() if folder == "object"} - {_JUDGED_IN_A},
    }
    for fold, not_trained in judged.items():
        for folder in ("object", "weak"):
            names = [n for (f, n), drive in drive_of.items() if f == folder and drive not in not_trained]
            (out / f"{fold}_train_{folder}.txt").write_text("".join(f"{name}\n" for name in names))
        names = [n for (f, n), drive in drive_of.items() if f == "object" and drive in not_trained]
        (out / f"{fold}_judge.txt").write_text("".join(f"{name}\n" for name in names))


def config_text(row: str, fold: str, kitti: Path, out: Path, trainer: dict[str, Any]) -> str:
    """The TOML file of a row's training on a fold."""
    values = _BASE | ROWS[row][1] | trainer
    labelled_only = values.pop("labelled_only", False)
    text = "".join(f"{key} = {_toml(value)}\n" for key, value in values.items())
    for folder in ("object",) if labelled_only else ("object", "weak"):
        text += _frame_set(
            "train", kitti / folder, out / "prompts" / folder, out / f"{fold}_train_{folder}.txt"
        )
    return text + _frame_set(
        "validate_on", kitti / "object", out / "prompts" / "object", out / f"{fold}_judge.txt"
    )


def _frame_set(key: str, source: Path, prompts: Path, frames: Path) -> str:
    return f'[[data.{key}]]\nsource = "{source}"\nprompts = "{prompts}"\nframes = "{frames}"\n'


def _toml(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else repr(value).replace("'", '"')


# Of the frozen trunk, which all rows share; filled in the process that trains.
_MAPS: KnownMaps = {}


def run(path: Path, folder: Path, other_folders: Sequence[Path]) -> None:
    """Train as `boxlift train` does; targets that another row extracted are taken from there."""
    from boxlift.network.monocular_task import TARGETS_NAME, MonocularTask
    from boxlift.network.tasks import read_config
    from boxlift.network.trainer import train

    config = read_config(path)
    folder.mkdir(parents=True, exist_ok=True)
    for other in other_folders:
        if (other / TARGETS_NAME).exists() and not (folder / TARGETS_NAME).exists():
            shutil.copy(other / TARGETS_NAME, folder)
    task = MonocularTask(config.settings, folder, _MAPS)
    train(task, config.settings.trainer, folder, config.fingerprint)


def with_same_targets(row: str, fold: str, out: Path) -> list[Path]:
    """Folders of rows that are supervised by the same targets."""

    def targets(name: str) -> tuple[Any, Any]:
        changes = ROWS[name][1]
        return changes.get("data.targets"), changes.get("labelled_only")

    return [out / f"{other}_{fold}" for other in ROWS if other != row and targets(other) == targets(row)]


def judged_frames(kitti: Path, folders: dict[str, Path]) -> list[tuple[list[KittiObject], list[KittiObject]]]:
    """(predictions, truth) of every frame that one of the folds' runs was judged on."""
    source = open_source(kitti / "object")
    return [
        (read_file(path), load_objects("label_2", source, path.stem))
        for folder in folders.values()
        for path in sorted((folder / "predictions" / "data").glob("*.txt"))
    ]


def figures_of(frames: Sequence[tuple[list[KittiObject], list[KittiObject]]]) -> dict[str, float]:
    """KITTI's figures of cars."""
    from boxlift.network.judging import judge

    return judge([found for found, _ in frames], [truth for _, truth in frames], ["Car"])


def table_row(row: str, kitti: Path, folders: dict[str, Path]) -> str:
    """Easy / moderate / hard of each figure, moderate BEV and 3D at .5 with their interval, depth error."""
    frames = judged_frames(kitti, folders)
    figures = figures_of(frames)
    rng = np.random.default_rng(0)
    samples = [
        figures_of([frames[i] for i in rng.integers(len(frames), size=len(frames))])
        for _ in range(_RESAMPLES)
    ]
    cells = []
    for figure in _FIGURES:
        values = [figures.get(f"Car/{figure}_{d}", float("nan")) for d in ("easy", "moderate", "hard")]
        cell = " ".join(f"{value:4.1f}" for value in values)
        if figure.endswith("0.5"):
            spread = [sample.get(f"Car/{figure}_moderate", 0.0) for sample in samples]
            cell += " ({:.0f}-{:.0f})".format(*np.percentile(spread, (5, 95)))
        cells.append(cell)
    return f"{ROWS[row][0]:52s} {' | '.join(cells)} | {figures.get('Car/depth_error', float('nan')):.3f}"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kitti", type=Path, default=_DEFAULT_KITTI)
    parser.add_argument("--out", type=Path, default=Path("runs/table"))
    parser.add_argument("--rows", nargs="+", choices=list(ROWS), default=list(ROWS))
    parser.add_argument("--epochs", type=int, default=30)
    parser.add_argument("--learning-rate", type=float, default=1e-3)
    arguments = parser.parse_args()
    kitti, out = arguments.kitti.resolve(), arguments.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    trainer = {
        "trainer.epochs": arguments.epochs,
        "trainer.learning_rate": arguments.learning_rate,
        "trainer.schedule": "cosine",
        "trainer.clip_norm": 10.0,
    }
    # torch and ONNX Runtime in one process get in each other's way: a process for each.
    spawn = multiprocessing.get_context("spawn")
    with spawn.Pool(1) as pool:
        pool.apply(detect_prompts, (kitti, out / "prompts"))
    write_folds(kitti, out)
    with spawn.Pool(1) as pool:
        print(f"{arguments.epochs} epochs. Cars, AP R40, easy moderate hard (90 % interval of moderate)")
        print(f"{'':52s} BEV .5 | 3D .5 | BEV .3 | 3D .3 | median depth error", flush=True)
        for row in arguments.rows:
            folders = {}
            for fold in ("A", "B"):
                path, folders[fold] = out / f"{row}_{fold}.toml", out / f"{row}_{fold}"
                path.write_text(config_text(row, fold, kitti, out, trainer))
                pool.apply(run, (path, folders[fold], with_same_targets(row, fold, out)))
            print(table_row(row, kitti, folders), flush=True)


if __name__ == "__main__":
    main()
