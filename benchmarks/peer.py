"""POST /detect against LitServe with the same model: requests a second and latencies, in turn, in one run.

    python benchmarks/peer.py [--peer-python PATH] [--workers 1] [--threads 2] [--rounds 3] [--json FILE]

Both get the same forms (PNG of 1242 x 375 pixels, camera) on loopback and do the same with them, in as many
worker processes with as many threads of ONNX Runtime: decode the PNG, run the model that ships, decode the
boxes, write the same JSON (serving/litserve_service.py). That their answers are alike is checked first. Then,
round by round and for one after the other: a closed loop of 8 connections, for requests a second at
saturation; and Poisson arrivals at 0.6 of the slower one's rate, for p50 and p99. Printed are the median
rates of the rounds, quantiles of all their latencies, and ratios.

--peer-python is the interpreter of a virtual environment that has LitServe; without it, one is made for the
run. It is no extra of this package: it brings uvloop, which uvicorn takes wherever it finds it, and our
service is to be measured as it is installed.

What differs: LitServe runs on uvloop and httptools, ours on asyncio and h11. LitServe pickles a form through
a queue to its worker, keeps whatever comes without bound, and has no deadline here (timeout=False); ours
checks a form while it streams in, hands it over in shared memory, counts permits, tells stage times and logs
a line a request. Beside, ours has its labelling worker, idle.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import chain, cycle
from pathlib import Path
from typing import Any

import httpx

from boxlift.frame import Frame
from boxlift_client.detect_request import parts_of_image
from serving.load_loops import OK, Load, Run, quantile
from serving.prepared import DETECT, form_request, frames
from serving.report import circumstances, print_circumstances, summary, write_json
from serving.service_process import Service, free_port, running, running_boxlift

LITSERVE = "litserve==0.2.19"
OURS, THEIRS = "boxlift", "LitServe"
_PATHS = {OURS: "/detect", THEIRS: "/predict"}

_CONNECTIONS = 8
_SHARE = 0.6
_PROJECT = Path(__file__).resolve().parents[1]


@contextmanager
def peer_interpreter(given: Path | None) -> Iterator[Path]:
    """A Python that has LitServe, and from this one's environment all else."""
    if given is not None:
        yield given
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        (packages,) = folder.glob("lib/python*/site-packages")
        # Its own packages come first.
        (packages / "beside.pth").write_text("\n".join(path for path in sys.path if "packages" in path))
        python = folder / "bin" / "python"
        pip: list[str | Path] = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        subprocess.run([*pip, "-c", _PROJECT / "constraints.txt", LITSERVE], check=True)
        yield python


@contextmanager
def running_litserve(python: Path, workers: int, threads: int) -> Iterator[Service]:
    """LitServe with our model, ready."""
    port = free_port()
    script = Path(__file__).with_name("serving") / "litserve_service.py"
    paths = [str(_PROJECT / part) for part in ("model", "service", "clients")]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(paths)}
    command = [str(python), str(script), str(port), str(workers), str(threads)]
    with running(command, environment, "/health", f"http://127.0.0.1:{port}") as service:
        yield service


class Contest:
    """The two services, by name, and the load on each."""

    def __init__(self, services: dict[str, Service], chosen: Sequence[Frame]) -> None:
        self.loads = {}
        self._services = services
        self._forms = [_form(frame) for frame in chosen]
        for name, service in services.items():
            made = [form_request(service.url, DETECT, _PATHS[name], form) for form in self._forms]
            self.loads[name] = Load(service.url, cycle(made))

    def check_answers(self) -> None:
        """Raises RuntimeError where the services do not find the same."""
        for form in self._forms:
            images = {}
            for name, service in self._services.items():
                response = httpx.post(f"{service.url}{_PATHS[name]}", files=form, timeout=60)
                images[name] = response.raise_for_status().json()["images"]
            if images[OURS] != images[THEIRS]:
                told = {name: json.dumps(found)[:500] for name, found in images.items()}
                raise RuntimeError(f"the answers differ: {told}")

    async def rounds(
        self, count: int, seconds: float
    ) -> tuple[dict[str, list[Run]], dict[str, list[Run]], float]:
        """Runs at saturation and at a fixed rate, by name; and that rate."""
        saturated: dict[str, list[Run]] = {name: [] for name in self.loads}
        fixed: dict[str, list[Run]] = {name: [] for name in self.loads}
        for load in self.loads.values():
            await load.closed(_CONNECTIONS, 0.3 * seconds)
        for turn in range(count):
            for name, load in self._in_turn(turn):
                saturated[name].append(await load.closed(_CONNECTIONS, seconds))
        rate = _SHARE * min(_median_rate(runs) for runs in saturated.values())
        for turn in range(count):
            for name, load in self._in_turn(turn):
                fixed[name].append(await load.open(rate, seconds, seed=turn))
        return saturated, fixed, rate

    def _in_turn(self, turn: int) -> list[tuple[str, Load]]:
        """Who went first goes second the next time."""
        return list(self.loads.items())[:: -1 if turn % 2 else 1]


def _form(frame: Frame) -> Any:
    assert frame.image is not None
    return parts_of_image(frame.image, frame.calibration, None, None, frame.name)


def _median_rate(runs: Sequence[Run]) -> float:
    return statistics.median(run.per_second() for run in runs)


def _quantile_ms(runs: Sequence[Run], share: float) -> float:
    """Of the answers of all rounds together: a round has too few for a p99."""
    return 1000 * quantile(sorted(chain.from_iterable(run.latencies_s() for run in runs)), share)


def results_of(saturated: Sequence[Run], fixed: Sequence[Run]) -> dict[str, float]:
    """What is compared, of one service."""
    return {
        "requests/s, saturated": _median_rate(saturated),
        "p99 ms, saturated": _quantile_ms(saturated, 0.99),
        "p50 ms, fixed rate": _quantile_ms(fixed, 0.5),
        "p99 ms, fixed rate": _quantile_ms(fixed, 0.99),
        "not answered with 200": sum(len(run.outcomes) - run.verdicts[OK] for run in (*saturated, *fixed)),
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--peer-python", type=Path)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=15, help="of each run")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    settings = {"detect_workers": str(arguments.workers), "detect_threads": str(arguments.threads)}
    told: dict[str, Any] = {**circumstances(settings), "peer": LITSERVE}
    print_circumstances(told)
    with (
        peer_interpreter(arguments.peer_python) as python,
        running_litserve(python, arguments.workers, arguments.threads) as theirs,
        running_boxlift(settings) as ours,
    ):
        contest = Contest({OURS: ours, THEIRS: theirs}, frames(None, 4))
        contest.check_answers()
        saturated, fixed, rate = asyncio.run(contest.rounds(arguments.rounds, arguments.seconds))
    results = {name: results_of(saturated[name], fixed[name]) for name in (OURS, THEIRS)}
    print(f"{arguments.rounds} rounds of {arguments.seconds:g} s; fixed rate {rate:.1f}/s; {LITSERVE}")
    print(f"{'':24}{OURS:>10}{THEIRS:>10}{'ratio':>8}")
    for what, value in results[OURS].items():
        other = results[THEIRS][what]
        print(f"{what:24}{value:10.1f}{other:10.1f}{value / other if other else float('nan'):8.2f}")
    runs: dict[str, dict[str, list[Run]]] = {"saturated": saturated, "fixed": fixed}
    told["runs"] = {
        kind: {name: [summary(run) for run in some] for name, some in by_name.items()}
        for kind, by_name in runs.items()
    }
    write_json(arguments.json, {**told, "fixed_rate": rate, "results": results})


if __name__ == "__main__":
    main()
