"""benchmarks/faults.py, briefly: whatever happens, requests are answered and nothing is left behind."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "faults.py"
SOON = ["--set", "receive_idle_s=1", "--set", "receive_limit_s=4"]


def accounts_of(told: Path, *arguments: str) -> dict[str, dict[str, Any]]:
    """The accounts of a short run, by fault."""
    command = [sys.executable, str(SCRIPT), "--short", "--json", str(told), *arguments]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert told.exists(), ran.stderr
    return {account["fault"]: account for account in json.loads(told.read_text())["faults"]}


@pytest.mark.parametrize(
    ("arguments", "faults"),
    [
        (
            ["--only", "kill,vanish,slow", "--kills", "1", *SOON],
            [
                "kill -9, label worker",
                "kill -9, detect worker",
                "client vanishes in upload",
                "client vanishes in answer",
                "slow uploads at once",
            ],
        ),
        (["--only", "end"], ["SIGTERM under load, 2 s to drain"]),
    ],
    ids=["one service", "its end"],
)
def test_faults_lose_no_request_and_leave_nothing(
    tmp_path: Path, arguments: list[str], faults: list[str]
) -> None:
    accounts = accounts_of(tmp_path / "faults.json", *arguments)
    assert list(accounts) == faults
    for account in accounts.values():
        # How soon it recovers is measured where the machine is quiet, by the benchmark.
        wrong = [sentence for sentence in account["wrong"] if not sentence.startswith("a recovery took")]
        assert wrong == [], account
        assert account["lost"] == 0, account
        assert account["answers"]["ok"] > 0, account
        assert account["left"] == {}, account
