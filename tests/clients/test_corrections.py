from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from boxlift.corrections.correction import Opinion, Verdict
from boxlift.corrections.store import CorrectionStore, default_url
from boxlift.formats.details import BoxDetails
from boxlift.label_sets.index import read_details, read_frames_of
from clients.command import Boxlift
from clients.label_sets import files_of

BOX = BoxDetails(center_cam=(1.0, 1.5, 20.0), length_m=4.5, width_m=1.9, height_m=1.7, rotation_y=0.3)


@pytest.fixture
def labels(labelled: Path, tmp_path: Path) -> Path:
    """A label set of three frames."""
    copied: Path = shutil.copytree(labelled, tmp_path / "labels")
    return copied


def test_corrections_are_laid_over_a_copy(labels: Path, boxlift: Boxlift) -> None:
    before = files_of(labels)
    store = CorrectionStore(default_url(labels), "labels")
    for index, opinion in enumerate(
        (
            Opinion(verdict=Verdict.CORRECTED, box=BOX, category="Van"),
            Opinion(verdict=Verdict.REJECTED),
            Opinion(verdict=Verdict.ACCEPTED),
        )
    ):
        store.add("000000", index, opinion, based_on=0, author="ann", request_id=f"request-{index}")
    store.add("000000", 2, Opinion(verdict=Verdict.OPEN), based_on=1, author="bob", request_id="taken-back")
    store.close()
    ran = boxlift("corrections", labels)
    assert ran.status == 0, ran.err
    assert "1  corrected" in ran.out
    assert "1  rejected" in ran.out
    assert "accepted" not in ran.out
    corrected = labels / "corrected"
    first, second, third, *_ = read_details(corrected / "details" / "000000.json").objects
    assert (first.box, first.category, first.result) == (BOX, "Van", "CORRECTED")
    assert (second.box, second.result) == (None, "REJECTED")
    assert third == read_details(labels / "details" / "000000.json").objects[2]
    lines = (corrected / "corrections.jsonl").read_text().splitlines()
    assert [json.loads(line)["author"] for line in lines] == ["ann", "ann", "ann", "bob"]
    untouched = "details/000001.json"
    assert (corrected / untouched).read_bytes() == (labels / untouched).read_bytes()
    for name, content in before.items():
        assert (labels / name).read_bytes() == content, name
    # Other commands take it.
    converted = boxlift("convert", corrected, "--to", "kitti", "--out", labels / "kitti")
    assert converted.status == 0, converted.err


def test_scores_are_calibrated_anew_on_request(labels: Path, boxlift: Boxlift) -> None:
    boxes = [(each.frame, item) for each in read_frames_of(labels) for item in each.objects if item.box]
    boxes.sort(key=lambda each: each[1].score)
    *judged, (frame, left) = boxes
    assert len(judged) >= 20
    store = CorrectionStore(default_url(labels), "labels")
    for at, (name, item) in enumerate(judged):
        opinion = Opinion(verdict=Verdict.REJECTED if at % 2 else Verdict.ACCEPTED)
        store.add(name, item.index, opinion, based_on=0, author="ann", request_id=f"request-{at}")
    store.close()
    ran = boxlift("corrections", labels, "--rescore")
    assert ran.status == 0, ran.err
    assert "Scores anew: logistic(" in ran.out
    after = read_details(labels / "corrected" / "details" / f"{frame}.json").objects[left.index]
    assert after.box == left.box
    assert after.score < left.score  # half of the sure ones were wrong
    assert after.kitti is not None
    assert after.kitti.score == after.score


def test_few_verdicts_calibrate_nothing(labels: Path, boxlift: Boxlift) -> None:
    store = CorrectionStore(default_url(labels), "labels")
    store.add(
        "000000", 0, Opinion(verdict=Verdict.ACCEPTED), based_on=0, author="ann", request_id="request-1"
    )
    store.close()
    ran = boxlift("corrections", labels, "--rescore")
    assert (ran.status, "Review at least 20" in ran.err) == (2, True)


def test_without_corrections_it_says_how_to_make_some(labels: Path, boxlift: Boxlift) -> None:
    ran = boxlift("corrections", labels)
    assert ran.status == 2
    assert "boxlift serve --label-sets" in ran.err


def test_the_machines_labels_are_never_overwritten(labels: Path, boxlift: Boxlift) -> None:
    ran = boxlift("corrections", labels, "--out", labels)
    assert ran.status == 2
    assert "machine's labels" in ran.err
