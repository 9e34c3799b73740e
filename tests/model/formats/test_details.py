"""Details: complete, rounded, the same bytes for the same labels."""

from __future__ import annotations

import json

import numpy as np
import pytest

from boxlift import Boxes3D, FrameLabels, ObjectLabel, Prompt, Result
from boxlift.formats import details, kitti_label
from boxlift.frame import FrameWarning, Hypothesis, LossTerms, PointCounts, RigDoubt


def box(x: float) -> Boxes3D:
    return Boxes3D(
        np.array([[x, 1, 10.00004]]), np.array([4.0]), np.array([1.8]), np.array([1.6]), np.array([-1e-9])
    )


LOSSES = LossTerms(0.123456, 0.2, 1.5, 0.05)
LABELS = FrameLabels(
    "000001",
    (
        ObjectLabel(
            0,
            Prompt("Car", (1.005, 2, 30, 40), 0.87654),
            Result.FITTED,
            Result.FITTED.value,
            box(2.00006),
            0.5,
            ("few_points",),
            LOSSES,
            PointCounts(50, 40, 30, 15),
            (Hypothesis(box(3), LOSSES, "The projected box fits worse."),),
        ),
        ObjectLabel(
            1, Prompt("Tram", (1, 2, 3, 4)), Result.UNKNOWN_CLASS, "The class 'Tram' has no size prior."
        ),
    ),
    (FrameWarning(RigDoubt.TILTED, "The ground leans 90 degrees."),),
)


def test_every_prompt_is_told() -> None:
    fitted, refused = json.loads(details.to_text(LABELS))["objects"]
    assert fitted["class"] == "Car"
    assert fitted["prompt_box_px"] == [1.0, 2.0, 30.0, 40.0]
    assert fitted["prompt_score"] == 0.8765
    assert (fitted["result"], fitted["sentence"], fitted["flags"]) == (
        "FITTED",
        "A box was fitted.",
        ["few_points"],
    )
    assert fitted["box"] == {
        "center_cam": [2.0001, 1.0, 10.0],
        "length_m": 4.0,
        "width_m": 1.8,
        "height_m": 1.6,
        "rotation_y": 0.0,
    }
    assert fitted["losses"] == {"geometric": 0.1235, "ray_tracing": 0.2, "center": 1.5, "total": 0.05}
    assert fitted["points"] == {"in_prompt": 50, "above_ground": 40, "in_cluster": 30, "used": 15}
    assert fitted["rejected"][0]["reason"] == "The projected box fits worse."
    assert fitted["rejected"][0]["box"]["center_cam"] == [3.0, 1.0, 10.0]
    assert (refused["index"], refused["result"], refused["box"], refused["kitti"]) == (
        1,
        "UNKNOWN_CLASS",
        None,
        None,
    )
    assert refused["sentence"] == "The class 'Tram' has no size prior."


def test_warnings_are_told_and_files_without_any_can_be_read() -> None:
    written = json.loads(details.to_text(LABELS))
    assert written["warnings"] == [{"name": "TILTED", "sentence": "The ground leans 90 degrees."}]
    del written["warnings"]
    assert details.parse_text(json.dumps(written)).warnings == ()


def test_kitti_fields_are_those_of_the_result_line() -> None:
    kitti = details.details_of(LABELS).objects[0].kitti
    assert kitti is not None
    line = kitti_label.parse_line(kitti_label.objects_of(LABELS)[0].to_line(), "a.txt")
    assert kitti.location == line.bottom_center_cam == (2.0, 1.8, 10.0)
    assert kitti.dimensions == line.size_hwl_m == (1.6, 1.8, 4.0)
    assert (kitti.alpha, kitti.rotation_y, kitti.score) == (line.alpha, line.rotation_y, line.score)
    assert (kitti.truncated, kitti.occluded) == (-1, -1)
    assert kitti.bbox[1:] == line.box_px[1:]


def test_same_labels_same_bytes_and_no_negative_zero() -> None:
    text = details.to_text(LABELS)
    assert text == details.to_text(LABELS)
    assert "-0.0," not in text
    assert text.endswith("}\n")


def test_text_round_trip() -> None:
    assert details.parse_text(details.to_text(LABELS)) == details.details_of(LABELS)


def test_schema_names_the_class_as_the_json_does() -> None:
    schema = details.ObjectDetails.model_json_schema(mode="serialization")
    assert "class" in schema["properties"]
    assert "category" not in schema["properties"]


@pytest.mark.parametrize("score", [float("nan"), float("inf")])
def test_numbers_that_json_has_not_become_null(score: float) -> None:
    odd = FrameLabels("f", (ObjectLabel(0, Prompt("Car", (0, 0, 1, 1), score), Result.BAD_BOX, "Bad."),))
    assert json.loads(details.to_text(odd))["objects"][0]["prompt_score"] is None
