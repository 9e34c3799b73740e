from __future__ import annotations

import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from boxlift.settings import RELEASE
from boxlift_client import LabelJob, Outcome, label_dataset
from boxlift_client.engines.http import HttpEngine
from boxlift_client.engines.local import LocalEngine
from boxlift_client.errors import NotAuthorizedError, ServiceUnreachableError, UnexpectedAnswerError
from boxlift_service.guards.api_keys import ApiKeys, add_key, new_key
from boxlift_service.guards.auth import AuthMiddleware
from boxlift_service.settings import ServiceSettings
from clients.killed_runs import write_many_frames
from clients.label_sets import files_of
from clients.scripted import Script, Scripted, scripted
from service.running import running_service
from service.served import served
from service.test_operation import Stopped, metric


def test_the_same_bytes_as_the_local_engine(dataset: Path, service_url: str, tmp_path: Path) -> None:
    masks = dataset / "training" / "masks"
    for engine, out in ((HttpEngine(service_url), "http"), (LocalEngine(1), "local")):
        job = LabelJob(dataset, tmp_path / out, "label_2", masks, RELEASE)
        assert label_dataset(job, engine).frames == {Outcome.LABELLED: 3}
    here, there = files_of(tmp_path / "local"), files_of(tmp_path / "http")
    assert len(here) == 7
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


def test_a_service_with_little_room_delays_frames_and_loses_none(dataset: Path, tmp_path: Path) -> None:
    job = LabelJob(dataset, tmp_path, "label_2", settings=RELEASE)
    limits = {"permits_per_worker": "0.5", "silence_s": "60"}  # two frames at a time
    with running_service(**limits) as little, ThreadPoolExecutor(1) as pool:
        with Stopped(little):
            labelling = pool.submit(label_dataset, job, HttpEngine(little.url))
            while not metric(little, 'boxlift_refused_total{pool="label",reason="too_busy"}'):
                assert not labelling.done()
                time.sleep(0.05)
        assert labelling.result().frames == {Outcome.LABELLED: 3}


def test_an_unknown_key_is_one_error_and_not_one_per_frame(dataset: Path, tmp_path: Path) -> None:
    add_key(tmp_path / "keys", new_key("studio")[1])
    keys, settings = ApiKeys(tmp_path / "keys"), ServiceSettings(api_keys=tmp_path / "keys")
    app = AuthMiddleware(Script("", [Scripted()]), keys, settings, lambda _: None)
    with served(app) as server, pytest.raises(NotAuthorizedError):
        label_dataset(LabelJob(dataset, tmp_path / "out", "label_2"), HttpEngine(server.url))


def test_services_share_the_frames_and_one_that_is_killed_loses_none(
    service_url: str, tmp_path: Path
) -> None:
    write_many_frames(tmp_path / "data", count=40, scenes=2)
    job = LabelJob(tmp_path / "data", tmp_path / "out", "label_2", settings=RELEASE)
    with running_service() as other:
        # The third was never there.
        engine = HttpEngine([service_url, other.url, "http://127.0.0.1:9"], workers=2)
        killed_at: list[int] = []

        def kill_soon(done: int, _: int) -> None:
            if not killed_at and metric(other, 'boxlift_request_seconds_count{route="/label"}') >= 3:
                other.process.kill()
                killed_at.append(done)

        summary = label_dataset(job, engine, on_progress=kill_soon)
    assert summary.frames == {Outcome.LABELLED: 40}
    assert killed_at[0] < 40


def test_services_that_label_differently_are_not_mixed(
    dataset: Path, service_url: str, tmp_path: Path
) -> None:
    script = Scripted(200, b'{"boxlift_version": "0.0.1", "labellers": [], "detector": null}')
    with scripted(script) as old, pytest.raises(UnexpectedAnswerError, match=r"labels otherwise .*0\.0\.1"):
        label_dataset(LabelJob(dataset, tmp_path, "label_2"), HttpEngine([service_url, old.url]))
