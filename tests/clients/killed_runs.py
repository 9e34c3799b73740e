"""Runs of `boxlift label` whose processes are killed with SIGKILL, and what must be there all the same."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import psutil

from boxlift.datasets.generated import generate, write_dataset
from boxlift_client.ledger import read_rows
from clients.label_sets import files_of

BOXLIFT = (str(Path(sys.executable).with_name("boxlift")),)
RUNNER, WORKER = "runner", "worker"
_PATIENCE_S = 120.0


def write_many_frames(root: Path, count: int, scenes: int) -> None:
    """`count` frames in KITTI object layout: `scenes` generated ones, again and again under other names.

    A frame's name seeds its random choices, so that the labels of no two are the same bytes.
    """
    write_dataset(root, (generate(seed) for seed in range(scenes)))
    for folder in (root / "training").iterdir():
        originals = sorted(folder.iterdir())
        for index in range(scenes, count):
            original = originals[index % scenes]
            os.link(original, folder / f"{index:06d}{original.suffix}")


def run_undisturbed(arguments: Sequence[object]) -> None:
    """`boxlift label ARGUMENTS...`, to its end."""
    subprocess.run([*BOXLIFT, "label", *map(str, arguments)], check=True, stdout=subprocess.DEVNULL)


@dataclass
class KilledRuns:
    """`boxlift label ARGUMENTS...` with kills in between, started again wherever it ends too early.

    out: the label set that the arguments name. expected: what an undisturbed run leaves. A kill comes when
    the run has written some files more, at a moment that `random_` says.
    """

    arguments: Sequence[object]
    out: Path
    expected: dict[str, bytes]
    random_: random.Random
    frames_between: int = 30
    killed: Counter[str] = field(default_factory=Counter)
    starts: int = 0

    def kill(self, victims: Iterable[str]) -> None:
        """Kill one process after the other, RUNNER or WORKER, each in a run that is at work."""
        process = self._start()
        for victim in victims:
            process = self._at_work(process)
            if victim == RUNNER:
                process.kill()
                process.wait()
            elif not kill_a_worker(process.pid, self.random_):
                continue  # the run has just ended, or its workers have
            self.killed[victim] += 1
            self.require_whole()
            if process.poll() is not None:
                process = self._start()
        process.kill()
        process.wait()

    def finish(self) -> None:
        """Run to the end, without a kill. Raises CalledProcessError where a frame failed."""
        run_undisturbed(self.arguments)

    def require_whole(self) -> None:
        """Every label file that is there holds what it must hold in the end."""
        for folder in ("data", "details"):
            if not (self.out / folder).is_dir():
                continue
            for path in (self.out / folder).iterdir():
                if path.name.startswith("."):
                    continue
                assert path.read_bytes() == self.expected[f"{folder}/{path.name}"], (
                    f"torn or different: {path}"
                )

    def require_complete(self) -> None:
        """All frames are there, byte for byte, nothing else is, and the ledger never said otherwise."""
        assert files_of(self.out) == self.expected
        digests: dict[str, set[str | None]] = {}
        for row in read_rows(self.out / "ledger"):
            assert row.error is None, f"{row.frame}: {row.error}"
            digests.setdefault(row.frame, set()).add(row.digest)
        assert sorted(f"data/{frame}.txt" for frame in digests) == sorted(
            name for name in self.expected if name.startswith("data/")
        )
        assert all(len(of_frame) == 1 for of_frame in digests.values())

    def _start(self) -> subprocess.Popen[bytes]:
        self.starts += 1
        command = [*BOXLIFT, "label", *map(str, self.arguments)]
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def _at_work(self, process: subprocess.Popen[bytes]) -> subprocess.Popen[bytes]:
        """Wait until some frames more are there; start again what has ended by itself."""
        enough = self._written() + self.random_.randint(1, self.frames_between)
        deadline = time.monotonic() + _PATIENCE_S
        while self._written() < enough:
            assert time.monotonic() < deadline, "the run does not go on"
            if process.poll() is not None:
                if process.returncode == 0:
                    return process  # done before the kill
                process = self._start()
            time.sleep(0.01)
        time.sleep(self.random_.random() * 0.05)
        return process

    def _written(self) -> int:
        folder = self.out / "data"
        return sum(path.suffix == ".txt" for path in folder.iterdir()) if folder.is_dir() else 0


def kill_a_worker(runner: int, random_: random.Random) -> bool:
    """Kill one of the processes that a local run labels with; False where there is none.

    Workers are children of the runner's fork server, which is left alone.
    """
    try:
        children = psutil.Process(runner).children()
        workers = [worker for child in children for worker in child.children()]
        if not workers:
            return False
        os.kill(random_.choice(workers).pid, signal.SIGKILL)
    except (psutil.NoSuchProcess, ProcessLookupError):
        return False
    return True
