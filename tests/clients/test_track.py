"""`boxlift track`: a label set in, a tracked one out, wherever it was killed; track ids in every format."""

from __future__ import annotations

import json
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from boxlift.datasets.generated import DriveSettings, generate_drive, write_drive
from boxlift.formats import argoverse2_boxes
from boxlift.formats.kitti_tracks import NO_TRACK, read_tracks
from boxlift.label_sets.index import read_details, read_sweeps_of
from boxlift_client.drive_record import read_record
from boxlift_client.engines.local import LocalEngine
from boxlift_client.job import LabelJob
from boxlift_client.runner import label_dataset
from boxlift_client.tracking import TrackJob, track_label_set
from clients.command import Boxlift
from clients.killed_runs import BOXLIFT
from clients.label_sets import files_of
from model.tracking.drives import SMALL_RIG

DRIVES, SWEEPS = ("0003", "0300"), 6


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two drives in KITTI tracking's layout, without poses."""
    root = tmp_path_factory.mktemp("drives")
    for name in DRIVES:
        write_drive(
            root, name, generate_drive(int(name), SMALL_RIG, DriveSettings(sweeps=SWEEPS), with_images=False)
        )
    return root


@pytest.fixture(scope="module")
def labels(drives: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Their labels. Copy them to change them."""
    out = tmp_path_factory.mktemp("labels") / "set"
    assert label_dataset(LabelJob(drives, out, "label_02"), LocalEngine(2)).complete
    return out


@pytest.fixture(scope="module")
def tracked(labels: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What tracking makes of them."""
    out = tmp_path_factory.mktemp("tracked") / "set"
    assert track_label_set(TrackJob(labels, out)).complete
    return out


def test_label_and_track_in_one_command(
    drives: Path, tracked: Path, tmp_path: Path, boxlift: Boxlift
) -> None:
    out = tmp_path / "out"
    ran = boxlift("label", drives, "--out", out, "--prompts", "label_02", "--sequence", "--workers", 1)
    assert ran.status == 0, ran.err
    assert f"2 drives, {2 * SWEEPS} frames" in ran.out
    assert "stand" in ran.out
    assert f"Labels are in {out / 'tracked' / 'data'}" in ran.out
    assert files_of(out / "tracked") == files_of(tracked)


def test_every_frame_has_its_labels_and_the_label_set_stays(labels: Path, tracked: Path) -> None:
    assert (tracked / "data").is_dir()
    for folder in ("data", "details"):
        names = {path.name for path in (labels / folder).iterdir()}
        assert {path.name for path in (tracked / folder).iterdir()} == names
    for path in (tracked / "details").iterdir():
        details = read_details(path)
        assert all(each.track for each in details.objects if each.box)
        lines = (tracked / "data" / f"{path.stem}.txt").read_text().splitlines()
        assert len(lines) == sum(each.kitti is not None for each in details.objects)
    assert json.loads((tracked / "manifest.json").read_text())["tracking"]["poses"] == "matched"
    assert json.loads((labels / "manifest.json").read_text())["tracking"] is None


def test_the_record_tells_before_and_after(tracked: Path) -> None:
    record = read_record(tracked, "0300")
    assert record is not None
    assert (record.drive, record.frames) == ("0300", SWEEPS)
    assert record.boxes_after >= record.boxes_before > 0
    assert record.objects["static"] >= 1
    assert record.length_m is not None
    assert record.length_m > 0


def test_what_is_done_is_not_done_again(
    labels: Path, tracked: Path, tmp_path: Path, boxlift: Boxlift
) -> None:
    out = tmp_path / "out"
    shutil.copytree(tracked, out)
    (out / "tracks" / "0300.json").unlink()
    (out / "data" / "0300_000002.txt").unlink()
    stamp = (out / "data" / "0003_000002.txt").stat().st_mtime_ns
    ran = boxlift("track", labels, "--out", out)
    assert ran.status == 0, ran.err
    assert "1 drive of them before this run." in ran.out
    assert (out / "data" / "0003_000002.txt").stat().st_mtime_ns == stamp
    assert files_of(out) == files_of(tracked)


def test_labels_that_changed_are_tracked_again(
    labels: Path, tracked: Path, tmp_path: Path, boxlift: Boxlift
) -> None:
    grown, out = tmp_path / "labels", tmp_path / "out"
    shutil.copytree(labels, grown)
    shutil.copytree(tracked, out)
    for folder, suffix in (("details", "json"), ("data", "txt")):
        (grown / folder / f"0300_000005.{suffix}").unlink()
    ran = boxlift("track", grown, "--out", out)
    assert ran.status == 0, ran.err
    record = read_record(out, "0300")
    assert record is not None
    assert record.frames == SWEEPS - 1


def test_processes_and_parts_change_no_byte(labels: Path, tracked: Path, tmp_path: Path) -> None:
    two = tmp_path / "two"
    assert track_label_set(TrackJob(labels, two), workers=2).complete
    assert files_of(two) == files_of(tracked)


def test_parts_of_the_drives_add_up(labels: Path, tracked: Path, tmp_path: Path, boxlift: Boxlift) -> None:
    out = tmp_path / "parts"
    for part in range(2):
        assert boxlift("track", labels, "--out", out, "--shard", f"{part}/2").status == 0
    assert files_of(out) == files_of(tracked)


def test_what_killed_writers_left_is_removed(labels: Path, tracked: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(tracked, out)
    (record, *_) = sorted((out / "tracks").glob("*.json"))
    left = [out / "tracks" / f".{record.name}.12-34.tmp", out / "tracks" / ".other.json.12-34.tmp"]
    for path in left:
        path.write_text("{")
    subprocess.run([*BOXLIFT, "track", str(labels), "--out", str(out)], check=True, stdout=subprocess.DEVNULL)
    # That of another drive may be another shard's, which is writing it.
    assert [path.exists() for path in left] == [False, True]


def test_nothing_is_lost_or_torn_where_it_is_killed(labels: Path, tracked: Path, tmp_path: Path) -> None:
    out, rng = tmp_path / "out", random.Random(3)
    command = [*BOXLIFT, "track", str(labels), "--out", str(out), "--workers", "1"]
    expected = files_of(tracked)
    for _ in range(3):
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        _wait_for_a_file(out, process)
        time.sleep(rng.uniform(0, 0.3))
        process.send_signal(signal.SIGKILL)
        process.wait()
        for name, content in files_of(out).items():
            if not Path(name).name.startswith("."):
                assert content == expected[name], f"torn or different: {name}"
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    assert files_of(out) == expected


def _wait_for_a_file(out: Path, process: subprocess.Popen[bytes]) -> None:
    count = len(files_of(out)) if out.is_dir() else 0
    for _ in range(600):
        if process.poll() is not None or (out.is_dir() and len(files_of(out)) > count):
            return
        time.sleep(0.05)
    pytest.fail("the run writes nothing")


def test_a_drive_that_cannot_be_read_costs_no_other(labels: Path, tmp_path: Path, boxlift: Boxlift) -> None:
    broken, out = tmp_path / "labels", tmp_path / "out"
    shutil.copytree(labels, broken)
    path = broken / "details" / "0300_000003.json"
    content = json.loads(path.read_text())
    content["objects"][0]["class"] = "Spaceship"
    path.write_text(json.dumps(content))
    ran = boxlift("track", broken, "--out", out)
    assert ran.status == 1
    assert "failed 0300" in ran.out
    assert "Spaceship" in ran.out
    assert read_record(out, "0003") is not None
    assert read_record(out, "0300") is None


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("nothing", "no label set"),
        ("tracked", "is tracked already"),
        ("no manifest", "has no manifest"),
        ("moved", "Give --source where it has moved"),
        ("itself", "is the label set itself"),
        ("no poses", "has no pose of this sweep"),
    ],
)
def test_wrong_input_is_refused_with_a_remedy(
    change: str, told: str, labels: Path, tracked: Path, tmp_path: Path, boxlift: Boxlift
) -> None:
    given, options = tmp_path / "labels", []
    if change == "tracked":
        given = tracked
    elif change != "nothing":
        shutil.copytree(labels, given)
    if change == "no manifest":
        (given / "manifest.json").unlink()
    if change == "moved":
        text = (given / "manifest.json").read_text()
        (given / "manifest.json").write_text(text.replace("/drives", "/elsewhere"))
    if change == "itself":
        options = ["--out", given]
    if change == "no poses":
        options = ["--poses", "dataset"]
    ran = boxlift("track", given, *options)
    assert ran.status in (1, 2)
    assert told in ran.out + ran.err


def test_other_options_need_another_folder(labels: Path, tracked: Path, boxlift: Boxlift) -> None:
    ran = boxlift("track", labels, "--out", tracked, "--fill", "view")
    assert ran.status == 2
    assert "tracking.fill 'gaps', not 'view'" in ran.err


def test_a_data_set_that_has_moved_is_named(
    drives: Path, labels: Path, tracked: Path, tmp_path: Path, boxlift: Boxlift
) -> None:
    moved, given = tmp_path / "moved", tmp_path / "labels"
    shutil.copytree(drives, moved)
    shutil.copytree(labels, given)
    text = (given / "manifest.json").read_text()
    (given / "manifest.json").write_text(text.replace(str(drives), "/nowhere"))
    assert boxlift("track", given, "--source", moved).status == 0
    for folder in ("data", "details"):
        ours, theirs = files_of(given / "tracked" / folder), files_of(tracked / folder)
        assert ours == theirs


def test_a_part_of_the_frames_is_no_drive(drives: Path, tmp_path: Path, boxlift: Boxlift) -> None:
    ran = boxlift("label", drives, "--out", tmp_path, "--prompts", "label_02", "--sequence", "--shard", "0/2")
    assert ran.status == 2
    assert "Give boxlift track when all parts are labelled" in ran.err


def test_without_kiss_icp_the_extra_is_named(
    labels: Path, tmp_path: Path, boxlift: Boxlift, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("kiss_icp", "kiss_icp.config", "kiss_icp.kiss_icp"):
        monkeypatch.setitem(sys.modules, module, None)
    ran = boxlift("track", labels, "--out", tmp_path / "out", "--workers", 1)
    assert ran.status == 2
    assert "boxlift[track]" in ran.err


def test_track_ids_are_in_every_format_that_has_them(tracked: Path, tmp_path: Path, boxlift: Boxlift) -> None:
    sweeps = list(read_sweeps_of(tracked))
    expected = [[each.track_id for each in sweep.objects] for sweep in sweeps]
    assert all(track is not None for each in expected for track in each)

    def convert(to: str, name: str) -> Path:
        ran = boxlift("convert", tracked, "--to", to, "--out", tmp_path / name)
        assert ran.status == 0, ran.err
        return tmp_path / name

    table = argoverse2_boxes.read_boxes(convert("argoverse2", "boxes.parquet"))
    assert [[each.track_id for each in sweep.objects] for sweep in table] == expected

    openlabel = json.loads((convert("openlabel", "openlabel") / "0300.json").read_text())["openlabel"]
    names = {key: each["name"] for key, each in openlabel["objects"].items()}
    of_log = [sweep for sweep in sweeps if sweep.log == "0300"]
    for frame, sweep in zip(openlabel["frames"].values(), of_log, strict=True):
        assert sorted(names[key] for key in frame["objects"]) == sorted(
            each.track_id or "" for each in sweep.objects
        )

    project = convert("supervisely", "supervisely") / "ds0" / "ann"
    keys: dict[tuple[str, str], set[str]] = {}
    for sweep in sweeps:
        annotation = json.loads((project / f"{sweep.sweep}.pcd.json").read_text())
        for figure, each in zip(annotation["figures"], sweep.objects, strict=True):
            keys.setdefault((sweep.log, each.track_id or ""), set()).add(figure["objectKey"])
    assert all(len(each) == 1 for each in keys.values())
    assert len({key for each in keys.values() for key in each}) == len(keys)

    folder = convert("kitti-tracking", "tracks")
    for log in DRIVES:
        by_frame = read_tracks(folder / f"{log}.txt")
        for number, sweep in enumerate(sweep for sweep in sweeps if sweep.log == log):
            lines = by_frame.get(number, [])
            assert sorted(str(each.track) for each in lines) == sorted(
                each.track_id or "" for each in sweep.objects
            )
            assert NO_TRACK not in {each.track for each in lines}
            assert all(each.line.score is not None for each in lines)


def test_labels_without_tracks_have_none_in_kitti_tracking(
    labels: Path, tmp_path: Path, boxlift: Boxlift
) -> None:
    assert boxlift("convert", labels, "--to", "kitti-tracking", "--out", tmp_path).status == 0
    assert {each.track for lines in read_tracks(tmp_path / "0003.txt").values() for each in lines} == {
        NO_TRACK
    }
