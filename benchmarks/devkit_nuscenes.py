"""boxlift's nuScenes metric beside the nuScenes devkit's own, on random boxes: the largest difference.

python benchmarks/devkit_scenes.py scenes.json        # in boxlift's environment
python -m venv devkit && devkit/bin/pip install nuscenes-devkit==1.2.0
devkit/bin/python benchmarks/devkit_nuscenes.py scenes.json
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from nuscenes.eval.common.config import config_factory
from nuscenes.eval.common.data_classes import EvalBoxes
from nuscenes.eval.detection.algo import accumulate, calc_ap, calc_tp
from nuscenes.eval.detection.data_classes import DetectionBox, DetectionConfig, DetectionMetrics
from pyquaternion import Quaternion

ERRORS = {"ate": "trans_err", "ase": "scale_err", "aoe": "orient_err", "aae": "attr_err"}


def eval_boxes(sweeps: list[list[dict[str, Any]]], ranges_m: dict[str, float]) -> EvalBoxes:
    """The devkit's boxes, filtered as filter_eval_boxes does by distance and points."""
    boxes = EvalBoxes()
    for index, sweep in enumerate(sweeps):
        boxes.add_boxes(
            f"{index:04d}",
            [
                DetectionBox(
                    sample_token=f"{index:04d}",
                    translation=tuple(each["center"]),
                    size=(each["lwh"][1], each["lwh"][0], each["lwh"][2]),
                    rotation=tuple(Quaternion(axis=[0, 0, 1], radians=each["yaw"]).elements),
                    ego_translation=tuple(each["center"]),
                    num_pts=each["points"],
                    detection_name=each["name"],
                    detection_score=each["score"],
                    attribute_name=each["attribute"],
                )
                for each in sweep
                if np.hypot(*each["center"][:2]) < ranges_m[each["name"]] and each["points"] != 0
            ],
        )
    return boxes


def judge(scene: dict[str, Any], config: DetectionConfig) -> DetectionMetrics:
    """As DetectionEval.evaluate, which wants the data set itself."""
    truth, found = (eval_boxes(scene[side], config.class_range) for side in ("truth", "predictions"))
    metrics = DetectionMetrics(config)
    for name in config.class_names:
        for distance_m in config.dist_ths:
            data = accumulate(truth, found, name, config.dist_fcn_callable, distance_m)
            metrics.add_label_ap(name, distance_m, calc_ap(data, config.min_recall, config.min_precision))
            if distance_m == config.dist_th_tp:
                for error in (*ERRORS.values(), "vel_err"):
                    untold = (name == "traffic_cone" and error in ("attr_err", "vel_err", "orient_err")) or (
                        name == "barrier" and error in ("attr_err", "vel_err")
                    )
                    value = np.nan if untold else calc_tp(data, config.min_recall, error)
                    metrics.add_label_tp(name, error, value)
    return metrics


def main() -> None:
    """Compare and print."""
    config = config_factory("detection_cvpr_2019")
    worst, compared = 0.0, 0
    for scene in json.loads(Path(sys.argv[1]).read_text()):
        metrics, ours = judge(scene, config), scene["nuscenes"]
        pairs = [
            (ours["means_of_ten"]["ap"] / 100, metrics.mean_ap),
            *((ours["means_of_ten"]["errors"][key], metrics.tp_errors[name]) for key, name in ERRORS.items()),
        ]
        for name, result in ours["results"].items():
            if result["truths"]:
                pairs.append((result["ap"] / 100, metrics.mean_dist_aps[name]))
                pairs += [
                    (value / 100, metrics.get_label_ap(name, float(key)))
                    for key, value in result["ap_at_m"].items()
                ]
                pairs += [
                    (value, metrics.get_label_tp(name, ERRORS[key]))
                    for key, value in result["errors"].items()
                    if value is not None
                ]
        worst = max(worst, *(abs(one - other) for one, other in pairs))
        compared += len(pairs)
    print(f"{compared} numbers compared, largest difference {worst:.2e}")


if __name__ == "__main__":
    main()
