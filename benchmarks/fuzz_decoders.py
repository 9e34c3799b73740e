"""Fuzzes every decoder of what a stranger may send: no crash, no warning, bounded time and memory.

    python benchmarks/fuzz_decoders.py [--inputs 200000] [--decoder NAME ...] [--seed 0] [--jobs 2] [--large]

Needs atheris (`pip install atheris`), which goes on from inputs that reached new lines of Python; four
of five mutations are our own (tests/fuzz/mutator.py), which know the formats. Each input must be decoded or
refused with an InputError, without a warning, in 0.25 s of processor time and 2 s of any, and in memory of
a small multiple of its size. What breaks this is written to tests/fuzz/found/, whose files
tests/fuzz/test_found.py examines ever after; the exit status is then 1. tests/fuzz/test_decoders.py is
the short form. --large measures instead what the largest inputs cost that are made to be slow.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

_TESTS = Path(__file__).resolve().parents[1] / "tests"
_FOUND = _TESTS / "fuzz" / "found"
DECODERS = (
    *("bin", "npy", "npz", "pcd-ascii", "pcd-binary", "pcd-compressed", "ply-ascii", "ply-little", "ply-big"),
    *(
        "calib-text",
        "calib-json",
        "calib-camera",
        "camera-config",
        "prompts",
        "prompt-lists",
        "options",
        "priors",
    ),
    *("png", "jpeg", "png-header", "jpeg-header", "masks", "form", "form-type", "msgpack"),
)


@dataclass(frozen=True)
class Result:
    """What a run of one decoder came to; findings in words."""

    inputs: int
    accepted: int
    refused: int
    slowest_s: float
    peak_bytes: int
    findings: tuple[str, ...]
    wall_s: float


def fuzz(name: str, inputs: int, seed: int) -> Result:
    """Fuzz one decoder in a process of its own."""
    start = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        result, log = Path(folder, "result.json"), Path(folder, "log")
        corpus = Path(folder, "corpus")
        corpus.mkdir()
        with log.open("wb") as stream:
            command = [sys.executable, "-m", "fuzz.guided", name, str(inputs), str(seed)]
            subprocess.run(
                [*command, str(result), str(_FOUND), str(corpus)],
                env={**os.environ, "PYTHONPATH": _python_path(), "PYTHONHASHSEED": "0"},
                stdout=stream,
                stderr=stream,
                check=False,
            )
        wall_s = time.monotonic() - start
        if not result.exists():
            tail = log.read_text(errors="replace")[-3000:]
            return Result(0, 0, 0, 0.0, 0, (f"the process ended:\n{tail}",), wall_s)
        values = json.loads(result.read_text())
    return Result(**{**values, "findings": tuple(values["findings"])}, wall_s=wall_s)


def _python_path() -> str:
    return os.pathsep.join(filter(None, (str(_TESTS), os.environ.get("PYTHONPATH"))))


def main() -> int:
    """Fuzz and print; 1 where something was found."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--inputs", type=int, default=200_000)
    parser.add_argument("--decoder", action="append", choices=DECODERS)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--large", action="store_true")
    arguments = parser.parse_args()
    if arguments.large:
        command = [sys.executable, "-m", "fuzz.large"]
        return subprocess.run(
            command, env={**os.environ, "PYTHONPATH": _python_path()}, check=False
        ).returncode
    names = arguments.decoder or DECODERS
    print("| decoder | inputs | accepted | refused | slowest, ms | peak, MB | findings | wall, s |")
    print("|---|---|---|---|---|---|---|---|")
    found: list[str] = []
    with ThreadPoolExecutor(arguments.jobs) as pool:
        # libFuzzer takes 0 for a seed of its own choice.
        results = pool.map(lambda name: fuzz(name, arguments.inputs, arguments.seed + 1), names)
        for name, result in zip(names, results, strict=True):
            print(
                f"| {name} | {result.inputs} | {result.accepted} | {result.refused} "
                f"| {1000 * result.slowest_s:.1f} | {result.peak_bytes / 1e6:.1f} "
                f"| {len(result.findings)} | {result.wall_s:.0f} |",
                flush=True,
            )
            found.extend(result.findings)
    for finding in found:
        print(finding)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
