"""The short form of benchmarks/kills.py: nothing that is killed costs a frame."""

from __future__ import annotations

import random
from pathlib import Path

from clients.killed_runs import RUNNER, WORKER, KilledRuns, run_undisturbed, write_many_frames
from clients.label_sets import files_of


def test_no_frame_is_lost_torn_or_different_when_processes_are_killed(tmp_path: Path) -> None:
    data = tmp_path / "data"
    write_many_frames(data, count=60, scenes=3)
    label = [data, "--prompts", "label_2", "--workers", 2]
    run_undisturbed([*label, "--out", tmp_path / "undisturbed"])
    expected = files_of(tmp_path / "undisturbed")
    assert len(expected) == 2 * 60 + 1
    out = tmp_path / "out"
    runs = KilledRuns([*label, "--out", out], out, expected, random.Random(5), frames_between=15)
    runs.kill([WORKER, RUNNER, WORKER])
    assert runs.killed[RUNNER] == 1
    assert runs.killed[WORKER] >= 1  # the last run may end before its kill
    runs.finish()
    runs.require_complete()
