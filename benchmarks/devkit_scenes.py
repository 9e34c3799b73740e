"""Random labels to judge, written for a data set's own devkit, which has an environment of its own.

    python benchmarks/devkit_scenes.py FILE

Writes FILE: per scene the boxes, and what boxlift's metrics say of them. benchmarks/devkit_nuscenes.py and
benchmarks/devkit_waymo.py read it.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from boxlift.evaluation import judge_like_nuscenes, judge_like_waymo, nuscenes_json, waymo_json
from boxlift.sweep import EgoObject, SweepLabels

SWEEPS = 60
# Seed, how often a second truth stands in the first (there the largest overlap is not all), and the IoU.
SCENES = ((0, 0.0, 0.5), (1, 0.5, 0.5), (2, 0.8, 0.3), (3, 0.0, 0.7), (4, 0.3, 0.1))
# Classes with other names at each; their attributes are nuScenes'.
CLASSES = {"car": ("vehicle.parked", "vehicle.moving", ""), "pedestrian": ("pedestrian.moving", "")}
OTHERS = {"bicycle": ("cycle.with_rider",), "barrier": ("",), "traffic_cone": ("",)}


def scene(seed: int, crowd: float) -> tuple[list[SweepLabels], list[SweepLabels]]:
    """Truths, and predictions that are off by some, turned round, doubled or made up."""
    random = np.random.default_rng(seed)
    classes = CLASSES | OTHERS
    truths: list[SweepLabels] = []
    predictions: list[SweepLabels] = []
    for index in range(SWEEPS):
        true: list[EgoObject] = []
        found: list[EgoObject] = []
        for _ in range(random.integers(0, 12)):
            name = str(random.choice(list(classes)))
            low, high = (-60, -60, -1, 3.5, 1.5, 1.4, -3.1), (60, 60, 1, 5, 2, 2, 3.1)
            row = random.uniform(low, high)
            attribute = str(random.choice(classes[name]))
            points = int(random.integers(0, 20))
            true.append(_object(name, row, 1.0, points, attribute))
            if random.random() < crowd:
                beside = row + random.normal(size=7) * (0.8, 0.4, 0, 0, 0, 0, 0)
                true.append(_object(name, beside, 1.0, int(random.integers(1, 20)), attribute))
            for _ in range(random.integers(0, 4)):
                off = row + random.normal(size=7) * (0.6, 0.4, 0.15, 0.3, 0.1, 0.1, 0.2)
                off[6] += np.pi * (random.random() < 0.1)
                said = str(random.choice(classes[name]))
                # Scores of two decimals are often the same, and often a cutoff.
                found.append(_object(name, off, round(random.beta(2, 2), 2), None, said))
        for _ in range(random.integers(0, 4)):
            row = random.uniform((-60, -60, -1, 3.5, 1.5, 1.4, -3.1), (60, 60, 1, 5, 2, 2, 3.1))
            found.append(_object("car", row, round(random.beta(2, 4), 2), None, "vehicle.moving"))
        truths.append(SweepLabels(f"{index:04d}", tuple(true)))
        predictions.append(SweepLabels(f"{index:04d}", tuple(found)))
    return truths, predictions


def _object(name: str, row: np.ndarray, score: float, points: int | None, attribute: str) -> EgoObject:
    x, y, z, length, width, height, yaw = (float(value) for value in row)
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    center = np.array([x, y, z])
    return EgoObject(
        name, center, turn, length, width, height, score, points=points, attribute=attribute or None
    )


def _boxes(labels: list[SweepLabels]) -> list[list[dict[str, object]]]:
    return [
        [
            {
                "name": each.category,
                "center": each.center_ego.tolist(),
                "lwh": [each.length_m, each.width_m, each.height_m],
                "yaw": each.yaw_rad,
                "score": each.score,
                "points": -1 if each.points is None else each.points,
                "attribute": each.attribute or "",
            }
            for each in sweep.objects
        ]
        for sweep in labels
    ]


def main() -> None:
    """Judge and write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("file", type=Path)
    arguments = parser.parse_args()
    written: list[dict[str, object]] = []
    for seed, crowd, iou in SCENES:
        truths, predictions = scene(seed, crowd)
        waymo, nuscenes = judge_like_waymo(truths, predictions, iou), judge_like_nuscenes(truths, predictions)
        written.append(
            {
                "iou": iou,
                "truth": _boxes(truths),
                "predictions": _boxes(predictions),
                "waymo": waymo_json(waymo, decimals=12)["results"],
                "nuscenes": nuscenes_json(nuscenes, decimals=12),
            }
        )
    arguments.file.write_text(json.dumps(written))


if __name__ == "__main__":
    main()
