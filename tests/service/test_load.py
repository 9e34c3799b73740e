"""benchmarks/load.py, briefly: what comes beyond the permits is refused, everything else is answered."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "load.py"


def test_under_any_load_a_request_is_answered_or_refused_with_retry_after(tmp_path: Path) -> None:
    told = tmp_path / "load.json"
    command = [sys.executable, str(SCRIPT), "--short", "1", "--frames", "1", "--json", str(told)]
    ran = subprocess.run(
        [*command, "--set", "permits_per_worker=2"], capture_output=True, text=True, timeout=300
    )
    assert told.exists(), ran.stderr
    report = json.loads(told.read_text())
    assert report["peak"]["per_second"] > 0
    steps = report["steps"]
    assert {verdict for step in steps for verdict in step["verdicts"]} <= {"ok", "429"}, ran.stdout
    beyond = steps[-1]
    assert beyond["step"].startswith("open, 3 x peak")
    assert beyond["verdicts"]["ok"] > 0
    # Two images for each worker are far less than what eight connections ask for.
    assert sum(step["verdicts"].get("429", 0) for step in steps) > 0
