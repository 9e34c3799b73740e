"""Frames that kill or hang, in processes and in actors of Ray; and the parts of a data set."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from boxlift.errors import OptionsError
from boxlift_client import LabelJob, Outcome
from boxlift_client.engines import Engine
from boxlift_client.engines.local import LocalEngine
from boxlift_client.engines.ray import RayEngine
from boxlift_client.errors import WorkersCannotStartError
from boxlift_client.shard import Shard, parse_shard
from clients.odd_workers import OddWorker, raising_worker

NAMES = [f"{index:04d}" for index in range(40)]


@pytest.fixture
def job(tmp_path: Path) -> LabelJob:
    return LabelJob(tmp_path, tmp_path, "label_2", frame_timeout_s=2.0)


def require_two_failures(engine: Engine, job: LabelJob) -> None:
    names = [*NAMES[:5], "dies", *NAMES[5:10], "hangs", *NAMES[10:], "dies once"]
    reports = {report.frame: report for report in engine.run(job, names)}
    assert sorted(reports) == sorted(names)
    failed = {name: report.sentence for name, report in reports.items() if report.outcome is Outcome.FAILED}
    assert sorted(failed) == ["dies", "hangs"]
    assert "3 worker processes died" in failed["dies"]
    assert "longer than 2 s" in failed["hangs"]
    assert "--frame-timeout" in failed["hangs"]


def test_processes(job: LabelJob) -> None:
    require_two_failures(LocalEngine(2, OddWorker), job)


def test_others_do_not_wait_for_a_frame_that_hangs(job: LabelJob) -> None:
    reports = [
        report.frame
        for report in LocalEngine(1, OddWorker).run(replace(job, frame_timeout_s=4.0), ["a", "hangs", *NAMES])
    ]
    # One worker was asked for: only its stand-in can have done them before the limit.
    assert reports[-1] == "hangs"
    assert sorted(reports) == sorted(["a", "hangs", *NAMES])


def test_workers_have_the_environment_of_their_runner(job: LabelJob, monkeypatch: pytest.MonkeyPatch) -> None:
    list(LocalEngine(1, OddWorker).run(job, ["a"]))  # the server that they are forked from is there
    monkeypatch.setenv("BOXLIFT_TOLD", "now")
    (report,) = LocalEngine(1, OddWorker).run(job, ["tells"])
    assert report.sentence == "now"


def test_a_worker_that_cannot_be_made_says_why(job: LabelJob) -> None:
    with pytest.raises(WorkersCannotStartError, match="ValueError: nothing is at"):
        list(LocalEngine(1, raising_worker).run(job, ["a"]))


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning", "ignore::FutureWarning")
def test_actors_of_ray(job: LabelJob, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[1]))  # where the nodes find OddWorker
    require_two_failures(RayEngine(2, make_worker=OddWorker), job)


def test_parts_are_disjoint_and_together_all() -> None:
    parts = [Shard(index, 7).of(NAMES) for index in range(7)]
    assert sorted(name for part in parts for name in part) == NAMES
    # A data set that grows keeps its frames where they were.
    grown = Shard(3, 7).of([*NAMES, "new"])
    assert [name for name in grown if name != "new"] == parts[3]


def test_parts_by_name_and_by_job() -> None:
    assert parse_shard("0/4") == Shard(0, 4)
    slurm = {"SLURM_ARRAY_TASK_ID": "3", "SLURM_ARRAY_TASK_MIN": "1", "SLURM_ARRAY_TASK_COUNT": "8"}
    assert parse_shard("auto", slurm) == Shard(2, 8)
    assert parse_shard("auto/16", {"JOB_COMPLETION_INDEX": "15"}) == Shard(15, 16)


@pytest.mark.parametrize(
    ("text", "environment"),
    [
        ("4/4", {}),
        ("-1/4", {}),
        ("1", {}),
        ("auto", {}),
        ("auto/4", {}),
        ("auto/4", {"JOB_COMPLETION_INDEX": "4"}),
        ("auto", {"SLURM_ARRAY_TASK_ID": "9", "SLURM_ARRAY_TASK_MIN": "1", "SLURM_ARRAY_TASK_COUNT": "3"}),
    ],
)
def test_what_is_no_part(text: str, environment: dict[str, str]) -> None:
    with pytest.raises(OptionsError, match="shard"):
        parse_shard(text, environment)
