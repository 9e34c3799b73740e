"""The monocular model on drives it was not trained on, beside geometry alone.

    python benchmarks/monocular_runs.py KITTI --out RUNS     (2D boxes, folds, configs)
    boxlift train RUNS/lifter_A.toml --out RUNS/lifter_A     (and lifter_B; minutes each on two cores)
    python benchmarks/monocular.py KITTI RUNS [--sequences] [--worst DIR]

A fold's model never saw the judged drives. 2D boxes are the detector's (or those of label_2, as prompts).
`both` judges the frames of both folds together, each by the model of its fold. Intervals are 90 % of 200
bootstraps over frames. The baselines take the same 2D boxes, frozen sizes and the road as heading.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from boxlift.boxes import Boxes3D
from boxlift.camera import Floats
from boxlift.evaluation import CLASS_RULES, KittiBenchmark, LabelTable
from boxlift.evaluation.label_table import pairs_in_frames
from boxlift.evaluation.rules import MODERATE, IouSet
from boxlift.formats.kitti_label import KittiObject, from_box3d
from boxlift.network.checkpoint import CHECKPOINT_NAME
from boxlift.network.config import DataSettings, FrameSet
from boxlift.network.detections import CLASSES
from boxlift.network.geometry import ground_line, normalised, typical_sizes
from boxlift.network.lifter import PROMPT_SCORE, Lifter, back_project
from boxlift.network.lifter_task import FrozenTrunk, build_lifter, lift_frame
from boxlift.network.tasks import read_config
from boxlift.network.training_frames import JudgedFrame, TrainingFrame, load_judged
from boxlift.overlap import iou_2d, iou_3d

Predict = Callable[[TrainingFrame], list[KittiObject]]
Predictions = dict[str, list[KittiObject]]
_BOOTSTRAPS = 200
_IOUS = (0.3, 0.5, 0.7)
# The height of KITTI's cameras above the road, from its sensor setup (cvlibs.net/datasets/kitti/setup.php).
_KITTI_CAMERA_HEIGHT_M = 1.65
# Of the baselines' scores: farther boxes are less likely right. Of 30, 60 and 120 m the best for them.
_SCORE_DEPTH_M = 60.0


@dataclass(frozen=True)
class Fold:
    """What a fold is judged on, by 2D boxes of the detector and of the labels."""

    name: str
    own: list[JudgedFrame]
    given: list[JudgedFrame]


def baseline(kind: str) -> Predict:
    """Geometry only. Depth of the nearest side from the frozen height, from the ground, or the mean of both,

    and half a length to the centre; `line`: the ground as all cars of the image show it.
    """

    def predict(frame: TrainingFrame) -> list[KittiObject]:
        boxes_px = torch.from_numpy(frame.boxes_px).float()
        P = torch.tensor(frame.image_P_cam, dtype=torch.float32)
        category = torch.from_numpy(frame.category)
        edges = normalised(boxes_px, P)
        sizes = typical_sizes()[category]
        bottom, height = edges[:, 3], (edges[:, 3] - edges[:, 1]).clamp(min=0.004)
        from_height = sizes[:, 2] / height
        line = ground_line(bottom, 1 / from_height, torch.from_numpy(frame.score).float() * (category == 0))
        from_ground = {
            "height": from_height,
            "mean": _KITTI_CAMERA_HEIGHT_M / bottom.clamp(min=0.012),
            "line": line.camera_height_m / (bottom - line.pitch).clamp(min=0.012),
        }[kind]
        face = (from_height + from_ground) / 2
        depth = face + sizes[:, 0] / 2
        middle = torch.stack([(boxes_px[:, 0] + boxes_px[:, 2]) / 2, boxes_px[:, 3]], 1)
        center = back_project(middle, depth, P)
        # The bottom edge of a 2D box is that of the nearest side.
        center[:, 1] = bottom * face - sizes[:, 2] / 2
        length, width, tall = sizes.double().numpy().T
        along = np.full(len(boxes_px), -np.pi / 2)
        boxes = Boxes3D(center.double().numpy(), length, width, tall, along)
        scores = frame.score * np.exp(-depth.numpy() / _SCORE_DEPTH_M)
        return _lines(frame, boxes, scores)

    return predict


def _lines(frame: TrainingFrame, boxes: Boxes3D, scores: Floats) -> list[KittiObject]:
    return [
        from_box3d(CLASSES[category], tuple(box_px), boxes[row : row + 1], float(scores[row]))
        for row, (category, box_px) in enumerate(zip(frame.category, frame.boxes_px.tolist(), strict=True))
    ]


def trained(run: Path, trunk: FrozenTrunk) -> Predict:
    """The head that a run of `boxlift train` ended with."""
    settings = read_config(run.with_suffix(".toml")).settings
    lifter: Lifter = build_lifter(settings.model)
    lifter.load_state_dict(torch.load(run / CHECKPOINT_NAME, weights_only=False)["model"])
    lifter.eval()
    return lambda frame: lift_frame(lifter, trunk, frame)


@dataclass(frozen=True)
class Score:
    """AP by (metric, IoU) as [easy, moderate, hard]; recall at .5 and depth error of moderate cars."""

    ap: Mapping[tuple[str, float], tuple[float, ...]]
    recall: float
    depth_error: float

    @property
    def figures(self) -> list[float]:
        """Those that intervals are told of: moderate BEV and 3D at .5, recall, depth error."""
        return [self.ap["bev", 0.5][1], self.ap["3d", 0.5][1], self.recall, self.depth_error]


def score(truths: Sequence[Sequence[KittiObject]], found: Sequence[Sequence[KittiObject]]) -> Score:
    """Cars of some frames against their truths."""
    truth, predicted = LabelTable.from_frames(truths), LabelTable.from_frames(found)
    benchmark = KittiBenchmark(truth, predicted)
    sets = [IouSet(CLASS_RULES["Car"].strict_iou, iou, iou) for iou in _IOUS]
    ap = {}
    for each in benchmark.average_precision("Car", sets):
        if each.recall_points == "R40":
            for metric, values in (("bev", each.ap_bev), ("3d", each.ap_3d)):
                ap[metric, each.iou_3d] = tuple(np.nan if value is None else value for value in values)
    recall, depth_error = _moderate(truth, predicted)
    return Score(ap, recall, depth_error)


def _moderate(truth: LabelTable, found: LabelTable) -> tuple[float, float]:
    """Share of moderate cars with a 3D IoU above .5, and the median relative depth error by their 2D box."""
    counted = truth.rows(truth.is_any_of(["Car"]) & truth.counts_as(MODERATE))
    cars = found.rows(found.is_any_of(["Car"]))
    rows, columns = pairs_in_frames(counted, cars)
    right = iou_3d(counted.boxes[rows], cars.boxes[columns]) > 0.5
    overlap = iou_2d(counted.box_px[rows], cars.box_px[columns])
    errors = []
    for index in range(len(counted)):
        own = np.flatnonzero(rows == index)
        if len(own) and overlap[own].max() > 0.5:
            best = columns[own[overlap[own].argmax()]]
            errors.append(abs(cars.boxes.center_cam[best, 2] / counted.boxes.center_cam[index, 2] - 1))
    return len(np.unique(rows[right])) / max(1, len(counted)), float(np.median(errors)) if errors else np.nan


def interval(truths: Sequence[Sequence[KittiObject]], found: Sequence[Sequence[KittiObject]]) -> list[str]:
    """90 % intervals of Score.figures over bootstraps of the frames."""
    rng = np.random.default_rng(0)
    drawn = [rng.integers(0, len(truths), len(truths)) for _ in range(_BOOTSTRAPS)]
    figures = np.array([score([truths[i] for i in d], [found[i] for i in d]).figures for d in drawn])
    low, high = np.nanpercentile(figures, (5, 95), axis=0)
    widths = ("{:.0f}-{:.0f}", "{:.0f}-{:.0f}", "{:.2f}-{:.2f}", "{:.3f}-{:.3f}")
    return [form.format(a, b) for form, a, b in zip(widths, low, high, strict=True)]


def print_row(title: str, frames: Sequence[JudgedFrame], found: Predictions) -> None:
    """One line of the table."""
    truths = [frame.truth for frame in frames]
    predictions = [found[frame.frame.name] for frame in frames]
    whole = score(truths, predictions)
    cells = [
        "/".join("-" if np.isnan(value) else f"{value:.1f}" for value in whole.ap[metric, iou])
        for iou in (0.5, 0.3, 0.7)
        for metric in ("bev", "3d")
    ]
    bev, volume, recall, depth = interval(truths, predictions)
    print(
        f"| {title} | {cells[0]} ({bev}) | {cells[1]} ({volume}) | {' | '.join(cells[2:])} "
        f"| {whole.recall:.2f} ({recall}) | {whole.depth_error:.3f} ({depth}) |",
        flush=True,
    )


def fold(name: str, kitti: Path, runs: Path, sequence: str | None) -> Fold:
    """Frames of a fold; of a sequence those of weak/ with the tracking benchmark's labels."""
    part = "object" if sequence is None else "weak"
    labels = "label_2" if sequence is None else str((runs / "labels_weak").resolve())
    frames = runs / (f"judge_{name}.txt" if sequence is None else f"judge_sequence_{sequence}.txt")
    data = DataSettings(targets="accurate", categories=CLASSES)

    def judged(prompts: str) -> list[JudgedFrame]:
        chosen = FrameSet(source=kitti / part, prompts=prompts, frames=frames, labels=labels)
        return load_judged([chosen], data)

    own = judged(str((runs / f"prompts_{part}").resolve()))
    return Fold(name, own, [_as_prompts(frame) for frame in judged(labels)])


def _as_prompts(judged: JudgedFrame) -> JudgedFrame:
    score = np.full(len(judged.frame.score), PROMPT_SCORE)
    return replace(judged, frame=replace(judged.frame, score=score))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("kitti", type=Path)
    parser.add_argument("runs", type=Path)
    parser.add_argument("--run", default="lifter", help="runs RUNS/NAME_A and RUNS/NAME_B")
    parser.add_argument("--sequences", action="store_true", help="judge on sequences 0009 and 0005, too")
    options = parser.parse_args()
    torch.set_num_threads(1)
    trunk = FrozenTrunk()
    print("Cars, AP R40 easy/moderate/hard; intervals of the moderate figures")
    print(
        "| 2D boxes, model, judged on | BEV@.5 | 3D@.5 | BEV@.3 | 3D@.3 | BEV@.7 | 3D@.7 | recall | depth |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    groups = {
        "object": [fold("A", options.kitti, options.runs, None), fold("B", options.kitti, options.runs, None)]
    }
    if options.sequences:
        pairs = [("A", "0009"), ("B", "0005")]
        groups["sequences"] = [fold(name, options.kitti, options.runs, each) for name, each in pairs]
    models: dict[str, dict[str, Predict]] = {
        **{f"geometry, {kind}": dict.fromkeys("AB", baseline(kind)) for kind in ("height", "mean", "line")},
        "ours": {name: trained(options.runs / f"{options.run}_{name}", trunk) for name in "AB"},
    }
    for group, folds in groups.items():
        for boxes in ("own", "given"):
            for title, of_fold in models.items():
                frames = {each.name: getattr(each, boxes) for each in folds}
                found = {
                    name: {judged.frame.name: of_fold[name](judged.frame) for judged in judgeds}
                    for name, judgeds in frames.items()
                }
                words = "detector's" if boxes == "own" else "label_2"
                for name, judgeds in frames.items():
                    print_row(f"{words}, {title}, {group} {name}", judgeds, found[name])
                both = [judged for judgeds in frames.values() for judged in judgeds]
                print_row(
                    f"{words}, {title}, {group} both",
                    both,
                    {k: v for each in found.values() for k, v in each.items()},
                )


if __name__ == "__main__":
    main()
