"""boxlift's Waymo metric beside the Waymo Open Dataset's own, on random boxes: the largest difference.

    python benchmarks/devkit_scenes.py scenes.json        # in boxlift's environment
    python3.11 -m venv devkit && devkit/bin/pip install tensorflow-cpu==2.13.0
    devkit/bin/pip install --no-deps waymo-open-dataset-tf-2-12-0==1.6.7
    devkit/bin/python benchmarks/devkit_waymo.py scenes.json

The wheel asks for exact versions of much that its metrics do not need; they load without.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from waymo_open_dataset import label_pb2
from waymo_open_dataset.metrics.ops import py_metrics_ops
from waymo_open_dataset.metrics.python import config_util_py
from waymo_open_dataset.protos import breakdown_pb2, metrics_pb2

TYPES = {"car": 1, "pedestrian": 2, "bicycle": None, "barrier": None, "traffic_cone": None}
NAMES = {"Vehicle": "VEHICLE", "Pedestrian": "PEDESTRIAN"}
RANGES = {"0-30 m": "[0, 30)", "30-50 m": "[30, 50)", "50 m-inf": "[50, +inf)"}


def configuration(iou: float, box_type: int) -> Any:
    """As tools/compute_detection_metrics_main.cc, at another IoU."""
    config = metrics_pb2.Config()
    for breakdown in (breakdown_pb2.Breakdown.OBJECT_TYPE, breakdown_pb2.Breakdown.RANGE):
        config.breakdown_generator_ids.append(breakdown)
        config.difficulties.add().levels.extend([label_pb2.Label.LEVEL_1, label_pb2.Label.LEVEL_2])
    config.matcher_type = metrics_pb2.MatcherProto.TYPE_HUNGARIAN
    config.iou_thresholds.extend([0.0, iou, iou, iou, iou])
    config.box_type = box_type
    config.score_cutoffs.extend([*(index * 0.01 for index in range(100)), 1.0])
    return config


def judge(scene: dict[str, Any], in_3d: bool) -> dict[str, tuple[float, float]]:
    """AP and APH by the name of their breakdown."""
    truth, found = (
        [(index, each) for index, sweep in enumerate(scene[side]) for each in sweep if TYPES[each["name"]]]
        for side in ("truth", "predictions")
    )
    truth = [(index, each) for index, each in truth if each["points"] != 0]
    columns = [0, 1, 2, 3, 4, 5, 6] if in_3d else [0, 1, 3, 4, 6]

    def boxes(of: list[tuple[int, dict[str, Any]]]) -> Any:
        rows = [[*each["center"], *each["lwh"], each["yaw"]] for _, each in of]
        return np.array(rows, dtype=np.float32)[:, columns]

    def types(of: list[tuple[int, dict[str, Any]]]) -> Any:
        return np.array([TYPES[each["name"]] for _, each in of], dtype=np.uint8)

    box_type = label_pb2.Label.Box.TYPE_3D if in_3d else label_pb2.Label.Box.TYPE_2D
    config = configuration(scene["iou"], box_type)
    metrics = py_metrics_ops.detection_metrics(
        prediction_bbox=boxes(found),
        prediction_type=types(found),
        prediction_score=np.array([each["score"] for _, each in found], dtype=np.float32),
        prediction_frame_id=np.array([index for index, _ in found], dtype=np.int64),
        prediction_overlap_nlz=np.zeros(len(found), dtype=bool),
        ground_truth_bbox=boxes(truth),
        ground_truth_type=types(truth),
        ground_truth_frame_id=np.array([index for index, _ in truth], dtype=np.int64),
        ground_truth_difficulty=np.array(
            [2 if each["points"] <= 5 else 1 for _, each in truth], dtype=np.uint8
        ),
        config=config.SerializeToString(),
    )
    names = config_util_py.get_breakdown_names_from_config(config)
    return dict(zip(names, zip(metrics[0].numpy(), metrics[1].numpy(), strict=True), strict=True))


def main() -> None:
    """Compare and print."""
    worst, compared = 0.0, 0
    for scene in json.loads(Path(sys.argv[1]).read_text()):
        for view in ("bev", "3d"):
            theirs = judge(scene, in_3d=view == "3d")
            for name, rows in scene["waymo"].items():
                for row in rows if name in NAMES else ():
                    breakdown = (
                        f"OBJECT_TYPE_TYPE_{NAMES[name]}_{row['level']}"
                        if row["range"] == "overall"
                        else f"RANGE_TYPE_{NAMES[name]}_{RANGES[row['range']]}_{row['level']}"
                    )
                    for key, value in zip(("ap", "aph"), theirs[breakdown], strict=True):
                        if row["truths"]:
                            worst = max(worst, abs(row[f"{key}_{view}"] / 100 - float(value)))
                            compared += 1
    print(f"{compared} numbers compared, largest difference {worst:.2e}")


if __name__ == "__main__":
    main()
