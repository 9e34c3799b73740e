"""How long the Waymo and the nuScenes metric take, and how much memory.

    python benchmarks/sweep_metrics.py [--sweeps 4000] [--boxes 30]

Random cars over 100 x 100 m, each with a prediction that is off by some; half of them with a second one.
Prints seconds of one process for each metric and the largest resident memory, that of the labels included.
"""

from __future__ import annotations

import argparse
import platform
import resource
import time

import numpy as np

from boxlift.evaluation import judge_like_nuscenes, judge_like_waymo
from boxlift.sweep import EgoObject, SweepLabels


def labels(sweeps: int, boxes: int) -> tuple[list[SweepLabels], list[SweepLabels]]:
    """Truths and predictions."""
    random = np.random.default_rng(0)
    truths: list[SweepLabels] = []
    predictions: list[SweepLabels] = []
    for index in range(sweeps):
        rows = random.uniform((-50, -50, -1, -3.1), (50, 50, 1, 3.1), (boxes, 4))
        found = np.concatenate([rows, rows[::2]])
        found += random.normal(size=found.shape) * (0.4, 0.2, 0.1, 0.1)
        scores = random.beta(2, 2, len(found)).round(4)
        truths.append(SweepLabels(f"{index:06d}", tuple(_car(row, 1.0) for row in rows)))
        objects = tuple(_car(row, score) for row, score in zip(found, scores, strict=True))
        predictions.append(SweepLabels(f"{index:06d}", objects))
    return truths, predictions


def _car(row: np.ndarray, score: float) -> EgoObject:
    cos, sin = np.cos(row[3]), np.sin(row[3])
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return EgoObject("car", row[:3], turn, 4.5, 1.9, 1.6, float(score), points=50)


def _peak_mib() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sweeps", type=int, default=4000)
    parser.add_argument("--boxes", type=int, default=30)
    arguments = parser.parse_args()
    truths, predictions = labels(arguments.sweeps, arguments.boxes)
    print(
        f"{platform.processor() or platform.machine()}, {arguments.sweeps} sweeps of {arguments.boxes} truths"
    )
    print(f"labels in memory: {_peak_mib()} MiB")
    for name, judge in (("waymo", judge_like_waymo), ("nuscenes", judge_like_nuscenes)):
        start = time.perf_counter()
        judge(truths, predictions)
        print(f"{name}: {time.perf_counter() - start:.2f} s, largest resident memory {_peak_mib()} MiB")


if __name__ == "__main__":
    main()
