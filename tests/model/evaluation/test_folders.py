"""Folders in; numbers, JSON and a table out."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from boxlift.errors import DatasetError, LabelFormatError, OptionsError
from boxlift.evaluation import evaluate_folders
from boxlift.formats.kitti_label import KittiObject, to_text
from model.evaluation.labels_to_judge import FRAMES, car, dont_care, found


def write(folder: Path, *objects: KittiObject, frames: int = FRAMES) -> Path:
    folder.mkdir(parents=True)
    for index in range(frames):
        (folder / f"frame {index}.txt").write_text(to_text(objects))
    return folder


def test_folders_of_perfect_labels(tmp_path: Path) -> None:
    truths = write(tmp_path / "gt", car(), dont_care(500.0))
    predictions = write(tmp_path / "pred", found(car()))
    evaluation = evaluate_folders(truths, predictions)
    assert evaluation.frame_count == FRAMES
    assert evaluation.results["Car"][0].ap_3d == pytest.approx((100, 100, 100))
    assert evaluation.pseudo_labels["Car"][0].at_iou[0].recall_3d == 1


def test_json_has_the_shape_of_the_recorded_values(tmp_path: Path) -> None:
    truths = write(tmp_path / "gt", car())
    predictions = write(tmp_path / "pred", found(car()))
    answer = json.loads(json.dumps(evaluate_folders(truths, predictions).to_json(), allow_nan=False))
    assert list(answer["results"]) == ["Car", "Pedestrian", "Cyclist"]
    entries = answer["results"]["Car"]
    assert [(entry["recall_points"], entry["iou_2d"], entry["iou_bev"]) for entry in entries] == [
        ("R11", 0.7, 0.7),
        ("R40", 0.7, 0.7),
        ("R11", 0.7, 0.5),
        ("R40", 0.7, 0.5),
    ]
    assert entries[0]["aos"] == [100.0, 100.0, 100.0]
    assert answer["results"]["Cyclist"][0]["ap_2d"] == [None, None, None]
    easy = answer["pseudo_labels"]["Car"][0]
    assert (easy["group"], easy["truths"], easy["at_iou"][0]["recall_bev"]) == ("easy", FRAMES, 1.0)
    assert answer["pseudo_labels"]["Van"][0]["truths"] == 0


def test_the_table_names_what_was_judged(tmp_path: Path) -> None:
    truths = write(tmp_path / "gt", car(), car(12.0, 600.0, category="Van"))
    predictions = write(tmp_path / "pred", found(car()))
    table = evaluate_folders(truths, predictions).to_table()
    assert "41 frames" in table
    assert "100.00" in table
    assert "Pedestrian" not in table
    assert "Van: 41 truths, none of them has a box" in table
    assert "Fewer than" not in table
    assert max(map(len, table.splitlines())) <= 110


def test_the_table_says_when_truths_are_few(tmp_path: Path) -> None:
    truths = write(tmp_path / "gt", car(), frames=40)
    predictions = write(tmp_path / "pred", found(car()), frames=40)
    evaluation = evaluate_folders(truths, predictions)
    assert evaluation.results["Car"][1].ap_3d == pytest.approx((97.5, 97.5, 97.5))
    assert "Fewer than 41 truths at a difficulty of Car" in evaluation.to_table()


def test_frames_can_be_named(tmp_path: Path) -> None:
    truths = write(tmp_path / "gt", car(), frames=3)
    predictions = write(tmp_path / "pred", found(car()), frames=1)
    assert evaluate_folders(truths, predictions, frames=["frame 0"]).frame_count == 1


def test_the_data_folder_of_a_labelling_run_is_found(tmp_path: Path) -> None:
    truths = write(tmp_path / "gt", car())
    write(tmp_path / "run" / "data", found(car()))
    assert evaluate_folders(truths, tmp_path / "run").results["Car"][0].ap_3d[0] == pytest.approx(100)


def test_labels_without_scores_can_be_judged(tmp_path: Path) -> None:
    truths = write(tmp_path / "gt", car())
    assert evaluate_folders(truths, truths).results["Car"][0].ap_3d[0] == pytest.approx(100)


def test_no_prediction_at_all(tmp_path: Path) -> None:
    evaluation = evaluate_folders(write(tmp_path / "gt", car()), write(tmp_path / "pred"))
    assert evaluation.results["Car"][0].ap_3d == (0, 0, 0)
    assert evaluation.pseudo_labels["Car"][0].at_iou[0].recall_3d == 0
    assert "Car: 41 truths, none of them has a box" in evaluation.to_table()


def test_no_truth_and_no_prediction_at_all(tmp_path: Path) -> None:
    evaluation = evaluate_folders(write(tmp_path / "gt", frames=1), write(tmp_path / "pred", frames=1))
    assert evaluation.results["Car"][0].ap_3d == (None, None, None)
    assert "1 frame" in evaluation.to_table()


def test_missing_files_are_counted_and_named(tmp_path: Path) -> None:
    truths = write(tmp_path / "gt", car(), frames=9)
    predictions = write(tmp_path / "pred", found(car()), frames=4)
    with pytest.raises(
        DatasetError, match=r"5 of 9 frames have no label file \(frame 4, frame 5, frame 6, "
    ) as e:
        evaluate_folders(truths, predictions)
    assert e.value.field == str(predictions)
    with pytest.raises(DatasetError, match="1 of 1 frames have no label file"):
        evaluate_folders(truths, predictions, frames=["another"])


def test_folders_that_hold_nothing(tmp_path: Path) -> None:
    predictions = write(tmp_path / "pred", found(car()))
    with pytest.raises(DatasetError, match="the folder is not there"):
        evaluate_folders(tmp_path / "gt", predictions)
    (tmp_path / "gt").mkdir()
    with pytest.raises(DatasetError, match="no frame to judge"):
        evaluate_folders(tmp_path / "gt", predictions)


def test_wrong_lines_and_classes(tmp_path: Path) -> None:
    truths = write(tmp_path / "gt", car(), frames=1)
    (tmp_path / "pred").mkdir()
    (tmp_path / "pred" / "frame 0.txt").write_text("Car 1 2 3\n")
    with pytest.raises(LabelFormatError, match="4 columns"):
        evaluate_folders(truths, tmp_path / "pred")
    with pytest.raises(OptionsError, match="'Tram' has no rules"):
        evaluate_folders(truths, truths, classes=["Tram"])
