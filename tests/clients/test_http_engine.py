from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from boxlift.settings import RELEASE
from boxlift_client import LabelJob, Outcome, label_dataset
from boxlift_client.engines.http import HttpEngine
from boxlift_client.engines.local import LocalEngine
from boxlift_client.errors import ServiceUnreachableError


def test_the_same_bytes_as_the_local_engine(dataset: Path, service_url: str, tmp_path: Path) -> None:
    masks = dataset / "training" / "masks"
    for engine, out in ((HttpEngine(service_url), "http"), (LocalEngine(1), "local")):
        job = LabelJob(dataset, tmp_path / out, "label_2", masks, RELEASE)
        assert label_dataset(job, engine).frames == {Outcome.LABELLED: 3}
    here, there = _contents(tmp_path / "local"), _contents(tmp_path / "http")
    assert len(here) == 6
    assert here == there


def test_what_is_wrong_with_a_frame_costs_no_other(dataset: Path, service_url: str, tmp_path: Path) -> None:
    root = tmp_path / "dataset"
    shutil.copytree(dataset, root)
    split = root / "training"
    (split / "velodyne" / "000000.bin").write_bytes(b"\0" * 17)
    # More prompts than the service takes: what it refuses is the frame's sentence.
    line = (split / "label_2" / "000001.txt").read_text().splitlines()[0]
    (split / "label_2" / "000001.txt").write_text(f"{line}\n" * 1001)
    progress: list[tuple[int, int]] = []
    summary = label_dataset(
        LabelJob(root, tmp_path / "out", "label_2"),
        HttpEngine(service_url, workers=2),
        on_progress=lambda done, total: progress.append((done, total)),
    )
    assert summary.frames == {Outcome.LABELLED: 1, Outcome.FAILED: 2}
    sentences = {report.frame: report.sentence for report in summary.unlabelled}
    assert "17 bytes" in sentences["000000"]
    assert "there are 1001 prompts" in sentences["000001"]
    assert sorted(path.name for path in (tmp_path / "out" / "data").iterdir()) == ["000002.txt"]
    assert progress == [(done, 3) for done in range(4)]


def test_no_service_is_one_error_and_not_one_per_frame(dataset: Path, tmp_path: Path) -> None:
    job = LabelJob(dataset, tmp_path, "label_2")
    with pytest.raises(ServiceUnreachableError):
        label_dataset(job, HttpEngine("http://127.0.0.1:9"))


def _contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
