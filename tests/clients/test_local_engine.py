from __future__ import annotations

import multiprocessing
import os
import shutil
import threading
from pathlib import Path

from boxlift.datasets import load_prompts, open_source
from boxlift.formats import details, kitti_label
from boxlift.frame import FrameLabels
from boxlift.labeller import Labeller
from boxlift_client import LabelJob, Outcome, label_dataset
from boxlift_client.engines.local import LocalEngine
from boxlift_client.job import FrameReport
from clients.label_sets import files_of, text_at_its_place

NAMES = ["000000", "000001", "000002"]


def test_files_say_what_the_labeller_says_for_any_number_of_workers(dataset: Path, tmp_path: Path) -> None:
    source = open_source(dataset)
    expected: dict[str, FrameLabels] = {}
    prompt_count = 0
    for name in NAMES:
        labels = Labeller().label(source.load(name, load_prompts("label_2", source, name)))
        prompt_count += len(labels.objects)
        expected[name] = labels
    for workers in (1, 2):
        out = tmp_path / str(workers)
        summary = label_dataset(LabelJob(dataset, out, "label_2"), LocalEngine(workers))
        assert summary.complete
        assert summary.frames == {Outcome.LABELLED: 3}
        assert summary.results.total() == prompt_count
        files = files_of(out)
        assert len(files) == 7
        for name, labels in expected.items():
            written = files[f"details/{name}.json"]
            assert written.decode() == text_at_its_place(details.details_of(labels), written)
            # Files are written from rounded details, which know no negative zero.
            lines = kitti_label.to_text(kitti_label.objects_of(labels))
            assert files[f"data/{name}.txt"].decode() == lines.replace(" -0.00 ", " 0.00 ")
        for name in NAMES:
            lines = (out / "data" / f"{name}.txt").read_text()
            assert {len(line.split()) for line in lines.splitlines()} == {16}


def test_what_is_wrong_with_a_frame_costs_no_other(dataset: Path, tmp_path: Path) -> None:
    root = tmp_path / "dataset"
    shutil.copytree(dataset, root)
    split = root / "training"
    for folder in ("calib", "label_2"):
        for name in ("truncated", "no_lidar", "no_prompts", "no_calibration"):
            shutil.copy(split / folder / "000000.txt", split / folder / f"{name}.txt")
    for name in ("truncated", "no_prompts", "no_calibration"):
        shutil.copy(split / "velodyne" / "000000.bin", split / "velodyne" / f"{name}.bin")
        shutil.copy(split / "image_2" / "000000.png", split / "image_2" / f"{name}.png")
    with (split / "velodyne" / "truncated.bin").open("ab") as file:
        file.write(b"\0\0\0")
    (split / "label_2" / "no_prompts.txt").unlink()
    (split / "calib" / "no_calibration.txt").unlink()
    (split / "label_2" / "000001.txt").write_text(
        "DontCare -1 -1 -10 0 0 9 9 -1 -1 -1 -1000 -1000 -1000 -10\n"
    )

    out = tmp_path / "out"
    names = [*open_source(root).names, "not_there"]
    summary = label_dataset(LabelJob(root, out, "label_2"), LocalEngine(1), names)

    assert not summary.complete
    assert summary.frames == {Outcome.LABELLED: 3, Outcome.SKIPPED: 1, Outcome.FAILED: 4}
    sentences = {report.frame: report.sentence for report in summary.unlabelled}
    assert "not a whole number of KITTI returns" in sentences["truncated"]
    assert "has no LiDAR points" in sentences["no_lidar"]
    assert "has no such file" in sentences["no_prompts"]
    assert "has no calibration" in sentences["no_calibration"]
    assert "no frame 'not_there'" in sentences["not_there"]
    assert sorted(path.stem for path in (out / "data").iterdir()) == sorted([*NAMES, "no_lidar"])
    assert (out / "data" / "no_lidar.txt").read_text() == ""
    no_lidar = details.parse_text((out / "details" / "no_lidar.json").read_text())
    assert {item.result for item in no_lidar.objects} == {"NO_LIDAR"}
    assert (out / "data" / "000001.txt").read_text() == ""  # no prompts, and still a file
    text = summary.text()
    assert text.startswith("8 frames: 3 labelled, 1 skipped, 4 failed")
    assert "failed truncated: " in text


def test_a_worker_that_is_killed_costs_no_frame(dataset: Path, tmp_path: Path) -> None:
    reports: list[FrameReport] = []
    for report in LocalEngine(1).run(LabelJob(dataset, tmp_path, "label_2"), NAMES):
        if not reports:
            _kill_workers()
        reports.append(report)
    assert sorted(report.frame for report in reports) == NAMES
    assert {report.outcome for report in reports} == {Outcome.LABELLED}


def test_a_frame_that_kills_its_worker_is_convicted_alone(dataset: Path, tmp_path: Path) -> None:
    root = tmp_path / "dataset"
    shutil.copytree(dataset, root)
    poison = root / "training" / "velodyne" / "000001.bin"
    poison.unlink()
    os.mkfifo(poison)  # whoever reads it hangs, and is then killed
    stop = threading.Event()
    killer = threading.Thread(target=_kill_readers, args=(poison, stop))
    killer.start()
    try:
        summary = label_dataset(LabelJob(root, tmp_path / "out", "label_2"), LocalEngine(1))
    finally:
        stop.set()
        killer.join()
    assert summary.frames == {Outcome.LABELLED: 2, Outcome.FAILED: 1}
    (failed,) = summary.unlabelled
    assert failed.frame == "000001"
    assert "3 worker processes died" in failed.sentence


def _kill_workers() -> None:
    for process in multiprocessing.active_children():
        process.kill()


def _kill_readers(fifo: Path, stop: threading.Event) -> None:
    while not stop.wait(0.05):
        try:
            descriptor = os.open(fifo, os.O_WRONLY | os.O_NONBLOCK)
        except OSError:  # nobody reads it
            continue
        _kill_workers()
        os.close(descriptor)
