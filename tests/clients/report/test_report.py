"""The report of a real label set, and of one that lacks things, in a browser and as text."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

from playwright.sync_api import expect, sync_playwright

from boxlift.corrections.correction import Opinion, Verdict
from boxlift.corrections.store import CorrectionStore, default_url
from boxlift.label_sets.index import read_frames_of
from boxlift_client.drive_record import DriveRecord, record_path
from clients.command import Boxlift


def test_says_the_same_as_the_evaluator(
    labelled: Path, dataset: Path, boxlift: Boxlift, tmp_path: Path
) -> None:
    out = tmp_path / "report.html"
    ran = boxlift("report", labelled, "--gt", "label_2", "--out", out)
    assert ran.status == 0, ran.err
    text = out.read_text()
    told = boxlift("evaluate", "--gt", dataset / "training" / "label_2", "--pred", labelled, "--json")
    groups = json.loads(told.out)["pseudo_labels"]["Car"]
    hard = next(each for each in groups if each["group"] == "hard")
    strict, loose = (f"{at['recall_3d']:.2f}" for at in hard["at_iou"])
    assert f"<td>Car</td><td>hard</td><td>{hard['truths']}</td><td>{loose}</td><td>{strict}</td>" in text
    assert "Boxes by score" in text
    assert "3 frames in the ledger" in re.sub(r"\s+", " ", text)
    assert text.count("data:image/jpeg;base64,") == 3


def test_without_truth_it_shows_what_is_worth_a_look(
    labelled: Path, boxlift: Boxlift, tmp_path: Path
) -> None:
    out = tmp_path / "deep" / "report.html"
    assert boxlift("report", labelled, "--out", out, "--pictures", 1).status == 0
    text = out.read_text()
    assert "Frames most worth a look" in text
    assert "Against the truth" not in text
    assert text.count("data:image/jpeg;base64,") == 1


def test_opens_in_a_browser_and_asks_for_nothing(
    labelled: Path, boxlift: Boxlift, tmp_path: Path, chromium: Path
) -> None:
    out = tmp_path / "report.html"
    boxlift("report", labelled, "--gt", "label_2", "--out", out)
    assert out.stat().st_size < 10 * 2**20
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page()
        asked: list[str] = []
        wrong: list[str] = []
        page.on("request", lambda request: asked.append(request.url))
        page.on("console", lambda message: wrong.append(message.text))
        page.goto(out.as_uri())
        expect(page.get_by_role("heading", level=1)).to_have_text("labels")
        expect(page.get_by_role("img").first).to_be_visible()
        browser.close()
    assert [each for each in asked if not each.startswith("data:")] == [out.as_uri()]
    assert wrong == []


def test_a_data_set_that_has_moved_costs_the_pictures_only(
    labelled: Path, boxlift: Boxlift, tmp_path: Path
) -> None:
    moved = shutil.copytree(labelled, tmp_path / "labels")
    manifest = moved / "manifest.json"
    manifest.write_text(re.sub(r'"path": "[^"]*"', '"path": "/nowhere/at/all"', manifest.read_text()))
    out = tmp_path / "report.html"
    assert boxlift("report", moved, "--out", out).status == 0
    assert "is not drawn" in out.read_text()
    assert "Give --source where it has moved." in out.read_text()


def test_wrong_input_is_told(labelled: Path, boxlift: Boxlift, tmp_path: Path) -> None:
    ran = boxlift("report", tmp_path)
    assert (ran.status, "has no manifest.json" in ran.err) == (2, True)
    ran = boxlift("report", labelled, "--gt", tmp_path / "nothing")
    assert (ran.status, "no frame of the label set has a truth" in ran.err) == (2, True)


def test_the_given_frames(kitti_object_root: Path, boxlift: Boxlift, tmp_path: Path) -> None:
    """Five of them: what the command does with all is in the closing notes."""
    frames = tmp_path / "frames"
    names = sorted(path.stem for path in (kitti_object_root / "training" / "velodyne").glob("*.bin"))[:5]
    frames.write_text("\n".join(names))
    boxlift(
        "label", kitti_object_root, "--out", tmp_path / "l", "--prompts", "label_2", "--frames", frames,
        "--workers", 1,
    )  # fmt: skip
    out = tmp_path / "report.html"
    assert boxlift("report", tmp_path / "l", "--gt", "label_2", "--out", out).status == 0
    assert out.stat().st_size < 10 * 2**20
    assert "Against the truth" in out.read_text()


def test_says_what_reviewers_and_drives_said(labelled: Path, boxlift: Boxlift, tmp_path: Path) -> None:
    labels = tmp_path / "labels"
    shutil.copytree(labelled, labels)
    store = CorrectionStore(default_url(labels), labels.name)
    details = next(iter(read_frames_of(labels)))
    boxed = [item for item in details.objects if item.box is not None]
    for number, verdict in enumerate((Verdict.ACCEPTED, Verdict.REJECTED)):
        opinion = Opinion(verdict=verdict)
        index = boxed[number].index
        store.add(details.frame, index, opinion, based_on=0, author="Ada", request_id=f"{number}")
    store.close()
    (labels / "tracks").mkdir()
    record = DriveRecord(
        drive="0042", labels="", frames=3, boxes_before=20, boxes_after=22, given_a_box=1, filled=1,
        objects={"static": 4, "moving": 2}, place_m=0.31, length_m=None, turned=2,
    )  # fmt: skip
    record_path(labels, "0042").write_text(record.text())
    (labels / "tracks" / "broken.json").write_text("{")
    out = tmp_path / "report.html"
    ran = boxlift("report", labels, "--out", out)
    assert ran.status == 0, ran.err
    text = out.read_text()
    assert "What reviewers said" in text
    assert "<td>no flag</td>" in text or "<td>heading ambiguous</td>" in text
    cells = ["0042", "3", "20", "22", "1", "1", "2 moving, 4 static", "0.31", "-", "2"]
    assert "".join(f"<td>{cell}</td>" for cell in cells) in text
    assert boxlift("corrections", labels).status == 0
    assert boxlift("report", labels / "corrected", "--out", out).status == 0
    assert "What reviewers said" in out.read_text()
    assert boxlift("report", labelled, "--out", out).status == 0
    assert "What reviewers said" not in out.read_text()
    assert "<h2>Drives</h2>" not in out.read_text()
