"""kill -9 of runners, workers and Ray drivers at random moments over one data set: what is left in the end.

    python benchmarks/kills.py [--kills 50] [--frames 1500] [--engine local|ray] [--seed 0]

Frames are generated. A run to its end comes first; then, in a folder of its own, runs that are killed (of the
local engine the runner or one of its workers by turns, of Ray the driver) and started again, and one that is
let finish. After every kill each label file that is there is compared with that of the first run; in the end
all bytes, and the digests of every row in the ledger.
"""

from __future__ import annotations

import argparse
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import cycle, islice
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from boxlift_client.ledger import read_rows
from clients.killed_runs import RUNNER, WORKER, KilledRuns, run_undisturbed, write_many_frames
from clients.label_sets import files_of

_SCENES = 12


def main() -> None:
    """Kill, compare and print; exits with an AssertionError where a frame is lost, torn or different."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--frames", type=int, default=1500)
    parser.add_argument("--engine", choices=("local", "ray"), default="local")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, _cluster(arguments.engine):
        data = Path(folder) / "data"
        write_many_frames(data, arguments.frames, _SCENES)
        label = [data, "--prompts", "label_2", "--workers", 2, "--engine", arguments.engine]
        if arguments.engine == "ray":
            label += ["--ray-address", "auto"]
        start = time.perf_counter()
        run_undisturbed([*label, "--out", Path(folder) / "undisturbed"])
        undisturbed_s = time.perf_counter() - start
        expected = files_of(Path(folder) / "undisturbed")
        victims = (RUNNER,) if arguments.engine == "ray" else (RUNNER, WORKER)
        out = Path(folder) / "killed"
        runs = KilledRuns(
            [*label, "--out", out],
            out,
            expected,
            random.Random(arguments.seed),
            frames_between=max(1, arguments.frames // arguments.kills),
        )
        start = time.perf_counter()
        runs.kill(islice(cycle(victims), arguments.kills))
        runs.finish()
        runs.require_complete()
        killed_s = time.perf_counter() - start
        rows = sum(1 for _ in read_rows(out / "ledger"))
        print(f"engine {arguments.engine}, {arguments.frames} frames, seed {arguments.seed}")
        print(f"killed with SIGKILL: {', '.join(f'{n} {who}s' for who, n in runs.killed.items())}")
        print(f"runs started: {runs.starts + 1}; {killed_s:.0f} s, undisturbed {undisturbed_s:.0f} s")
        print(f"frames lost 0, torn files 0, different files 0 of {len(expected)}")
        print(f"rows in the ledger {rows}; those that a killed runner had not written came with a later run")


@contextmanager
def _cluster(engine: str) -> Iterator[None]:
    """A Ray cluster on this machine that outlives its drivers."""
    if engine != "ray":
        yield
        return
    ray = str(Path(sys.executable).with_name("ray"))
    start = [ray, "start", "--head", "--num-cpus=2", "--include-dashboard=false", "--disable-usage-stats"]
    subprocess.run(start, check=True, stdout=subprocess.DEVNULL)
    try:
        yield
    finally:
        subprocess.run([ray, "stop", "--force"], check=False, stdout=subprocess.DEVNULL)


if __name__ == "__main__":
    main()
