"""Label sets: what a run leaves, and how the next one goes on with it."""

from __future__ import annotations

import errno
import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from boxlift.datasets.frames_file import read_frames
from boxlift.errors import DatasetError, MissingExtraError, OptionsError
from boxlift.formats.details import parse_text
from boxlift.label_sets.manifest import read_manifest
from boxlift.settings import PAPER
from boxlift_client import LabelJob, Outcome, label_dataset
from boxlift_client.errors import RunStoppedError
from boxlift_client.ledger import read_ledger, read_rows
from boxlift_client.shard import Shard
from clients.inline_engine import InlineEngine
from clients.label_sets import files_of

NAMES = ["000000", "000001", "000002"]


@pytest.fixture
def job(dataset: Path, tmp_path: Path) -> LabelJob:
    return LabelJob(dataset, tmp_path / "out", "label_2")


def test_a_run_leaves_labels_a_manifest_and_a_row_for_every_frame(job: LabelJob) -> None:
    label_dataset(job, InlineEngine())
    out = Path(str(job.out))
    assert sorted(files_of(out)) == sorted(
        ["manifest.json", *(f"data/{n}.txt" for n in NAMES), *(f"details/{n}.json" for n in NAMES)]
    )
    rows = sorted(read_rows(out / "ledger"), key=lambda row: row.frame)
    assert [(row.frame, row.outcome, row.attempt, row.error) for row in rows] == [
        (name, "labelled", 1, None) for name in NAMES
    ]
    assert all(row.results == {"NO_LIDAR": row.prompts} and row.seconds > 0 for row in rows if row.prompts)
    assert len({row.digest for row in rows}) == 3
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["prompts"] == "label_2"
    assert manifest["sources"] == [{"id": rows[0].source, "path": str(job.source), "layout": "KITTI object"}]


def test_details_say_where_the_camera_was(job: LabelJob) -> None:
    label_dataset(job, InlineEngine(), ["000000"])
    view = parse_text((job.out / "details" / "000000.json").read_bytes()).view
    assert view is not None
    assert (view.sweep, view.camera) == ("000000", "image_2")
    # The camera looks along x of the LiDAR frame, which is the ego frame here.
    assert [round(row[2]) for row in view.ego_SE3_cam[:3]] == [1, 0, 0]


def test_frames_that_are_done_are_not_asked_for_again(job: LabelJob) -> None:
    engine = InlineEngine({"000001": KeyboardInterrupt()})
    with pytest.raises(KeyboardInterrupt):
        label_dataset(job, engine)
    assert engine.asked == ["000000", "000001"]
    again = InlineEngine()
    progress: list[tuple[int, int]] = []
    summary = label_dataset(job, again, on_progress=lambda *done: progress.append(done))
    assert again.asked == ["000001", "000002"]
    assert progress == [(1, 3), (2, 3), (3, 3)]
    assert (summary.frames, summary.before) == ({Outcome.LABELLED: 3}, 1)
    assert summary.text().startswith("3 frames: 3 labelled, 0 skipped, 0 failed")
    assert "1 frame of them before this run." in summary.text()
    undisturbed = replace(job, out=Path(str(job.out)).with_name("undisturbed"))
    label_dataset(undisturbed, InlineEngine())
    assert files_of(Path(str(job.out))) == files_of(Path(str(undisturbed.out)))
    idle = InlineEngine()
    assert label_dataset(job, idle).before == 3
    assert idle.asked == []


def test_failed_frames_are_listed_and_tried_again_when_asked(job: LabelJob) -> None:
    broken = {"000001": ValueError("by a\nfault")}
    assert not label_dataset(job, InlineEngine(broken)).complete
    listed = Path(str(job.out)) / "failed.csv"
    assert listed.read_text() == "frame,attempts,sentence\n000001,1,ValueError: by a fault\n"
    assert read_frames(listed) == ["000001"]
    idle = InlineEngine()
    summary = label_dataset(job, idle)
    assert (idle.asked, summary.complete) == ([], False)
    assert "failed 000001: ValueError: by a\nfault" in summary.text()
    assert not label_dataset(job, InlineEngine(broken), retry_failed=True).complete
    assert listed.read_text().splitlines()[1].startswith("000001,2,")
    engine = InlineEngine()
    assert label_dataset(job, engine, retry_failed=True).complete
    assert engine.asked == ["000001"]
    assert not listed.exists()
    attempts = sorted(row.attempt for row in read_rows(job.out / "ledger") if row.frame == "000001")
    assert attempts == [1, 2, 3]


def test_labels_made_otherwise_are_not_mixed(job: LabelJob) -> None:
    label_dataset(job, InlineEngine())
    with pytest.raises(OptionsError, match=r"prompts 'label_2', not 'masks'"):
        label_dataset(replace(job, prompts="masks"), InlineEngine())
    with pytest.raises(OptionsError, match=r"settings\.\w+"):
        label_dataset(replace(job, settings=PAPER), InlineEngine())
    with pytest.raises(OptionsError, match=r"version '.*', not '9\.9'"):
        label_dataset(job, InlineEngine(version="9.9"))
    shutil.rmtree(str(job.out / "ledger"))
    (job.out / "manifest.json").unlink()
    with pytest.raises(OptionsError, match="holds labels without a manifest"):
        label_dataset(job, InlineEngine())


def test_a_second_data_set_joins_unless_its_names_clash(job: LabelJob, tmp_path: Path) -> None:
    label_dataset(job, InlineEngine())
    other = tmp_path / "other"
    shutil.copytree(str(job.source), other)
    with pytest.raises(OptionsError, match=r"has a frame '000000' already, of .*dataset"):
        label_dataset(replace(job, source=other), InlineEngine())
    for path in [path for path in other.rglob("00000*") if path.is_file()]:
        path.rename(path.with_name(f"b{path.name}"))
    summary = label_dataset(replace(job, source=other), InlineEngine())
    assert summary.frames == {Outcome.LABELLED: 3}
    manifest = read_manifest(job.out)
    assert manifest is not None
    assert [entry.path for entry in manifest.sources] == [str(job.source), str(other)]
    assert len(read_ledger(job.out / "ledger").done) == 6
    # Moved, and told so: the frames are known again.
    moved = tmp_path / "moved"
    other.rename(moved)
    text = (job.out / "manifest.json").read_text()
    (job.out / "manifest.json").write_text(text.replace(str(other), str(moved)))
    assert label_dataset(replace(job, source=moved), InlineEngine()).before == 3


def test_shards_share_the_frames_of_one_label_set(job: LabelJob) -> None:
    asked: list[str] = []
    for index in range(2):
        engine = InlineEngine()
        label_dataset(job, engine, shard=Shard(index, 2))
        asked += engine.asked
    assert sorted(asked) == NAMES
    assert label_dataset(job, InlineEngine()).before == 3


@pytest.mark.parametrize(
    ("error", "sentence"),
    [(OSError(errno.ENOSPC, "No space left"), "No space left"), (MissingExtraError("lzf", "label"), "lzf")],
)
def test_what_every_frame_would_meet_stops_the_run_and_fails_no_frame(
    job: LabelJob, error: Exception, sentence: str
) -> None:
    engine = InlineEngine({"000001": error})
    with pytest.raises(RunStoppedError, match=sentence):
        label_dataset(job, engine)
    state = read_ledger(job.out / "ledger")
    assert (list(state.done), state.failed) == (["000000"], {})
    assert label_dataset(job, InlineEngine()).complete


def test_what_killed_writers_left_is_removed_when_their_frame_is_done(job: LabelJob) -> None:
    label_dataset(job, InlineEngine(), ["000000"])
    litter = Path(str(job.out)) / "data" / ".000000.txt.123-456.tmp"
    not_ours = Path(str(job.out)) / "details" / ".other.json.123-456.tmp"
    for path in (litter, not_ours):
        path.write_text("half")
    label_dataset(job, InlineEngine())
    assert (litter.exists(), not_ours.exists()) == (False, True)


def test_nothing_to_label(job: LabelJob) -> None:
    with pytest.raises(DatasetError, match="no frame to label"):
        label_dataset(job, InlineEngine(), [])
