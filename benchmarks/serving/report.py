"""What a run is reported with: the machine, the commit, tables, and a JSON file."""

from __future__ import annotations

import json
import os
import platform
import subprocess
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from serving.load_loops import OK, REFUSED, Run, quantile

_HERE = Path(__file__).resolve().parent


def circumstances(settings: Mapping[str, str]) -> dict[str, Any]:
    """Where, with what and when something was measured."""
    return {
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, {_memory_gib():.0f} GiB",
        "kernel": platform.release(),
        "load_before": round(os.getloadavg()[0], 2),
        "python": platform.python_version(),
        "commit": commit(),
        "began": datetime.now(UTC).isoformat(timespec="seconds"),
        "settings": dict(settings),
    }


def commit() -> str:
    """The commit of this checkout; `-dirty` where files differ from it."""
    command = ["git", "describe", "--always", "--dirty"]
    ran = subprocess.run(command, cwd=_HERE, capture_output=True, text=True, check=False)
    return ran.stdout.strip() or "unknown"


def print_circumstances(told: Mapping[str, Any]) -> None:
    """Two lines."""
    print(f"{told['machine']}, load {told['load_before']} before; commit {told['commit']}")
    print("settings: " + (", ".join(f"{k}={v}" for k, v in told["settings"].items()) or "the defaults"))


def summary(run: Run, kind: str | None = None) -> dict[str, Any]:
    """Throughput, verdicts and latencies (milliseconds) of a run, of one kind of request or all."""
    latencies = run.latencies_s(kind)
    verdicts = {
        verdict: sum(one.verdict == verdict and kind in (None, one.kind) for one in run.outcomes)
        for verdict in sorted(run.verdicts)
    }
    return {
        "per_second": round(run.per_second(kind), 2),
        **{f"p{name}_ms": _ms(quantile(latencies, name / 100)) for name in (50, 95, 99)},
        "slowest_ms": _ms(latencies[-1] if latencies else float("nan")),
        "verdicts": {verdict: count for verdict, count in verdicts.items() if count},
    }


def print_run(name: str, run: Run, kinds: Sequence[str]) -> None:
    """A line for all requests of a run, and one for each kind."""
    for kind in (None, *kinds):
        told = summary(run, kind)
        verdicts = dict(told["verdicts"])
        ok, refused = verdicts.pop(OK, 0), verdicts.pop(REFUSED, 0)
        wrong = ", ".join(f"{count} x {verdict}" for verdict, count in verdicts.items()) or "0"
        times = "".join(f"{told[f'p{share}_ms'] or float('nan'):9.0f}" for share in (50, 95, 99))
        label = name if kind is None else f"  {kind}"
        print(f"{label:32}{told['per_second']:8.1f}{times}{ok:8}{refused:8}   {wrong}", flush=True)


RUN_HEADER = f"{'':32}{'ok/s':>8}{'p50 ms':>9}{'p95 ms':>9}{'p99 ms':>9}{'ok':>8}{'429':>8}   errors"


def write_json(path: Path | None, told: Mapping[str, Any]) -> None:
    """Write a file where one is wanted."""
    if path is not None:
        path.write_text(json.dumps(told, indent=1) + "\n")


def _ms(seconds: float) -> float | None:
    return None if seconds != seconds else round(1000 * seconds, 1)


def _memory_gib() -> float:
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
