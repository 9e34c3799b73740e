"""The benchmark against what the development kit itself said of 400 frames."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from boxlift.evaluation import AveragePrecision, evaluate_folders


def test_every_number_of_the_development_kit(oracle_root: Path) -> None:
    folder = oracle_root / "kitti_eval"
    recorded = json.loads((folder / "expected.json").read_text())["results"]
    evaluation = evaluate_folders(folder / "label_2", folder / "pred")

    def key(entry: AveragePrecision) -> tuple[str, float, float, float]:
        return entry.recall_points, entry.iou_2d, entry.iou_bev, entry.iou_3d

    compared = 0
    for category, entries in recorded.items():
        ours = {key(entry): entry for entry in evaluation.results[category]}
        for entry in entries:
            own = ours[entry["recall_points"], entry["iou_2d"], entry["iou_bev"], entry["iou_3d"]]
            for curve in ("ap_2d", "ap_bev", "ap_3d", "aos"):
                assert getattr(own, curve) == pytest.approx(entry[curve], abs=0.01), (category, entry, curve)
                compared += 3
    assert compared == 144
