"""The real service in a process of its own, on a port of its own."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import httpx

from service.frames import Fields, Parts

_START_S = 120.0


@dataclass(frozen=True)
class RunningService:
    """A service that listens; `process` is its process."""

    url: str
    process: subprocess.Popen[str]
    client: httpx.Client

    def label(self, fields: Fields, accept: str = "application/json") -> httpx.Response:
        """POST /label with a form."""
        return self.client.post("/label", files=list(fields.items()), headers={"Accept": accept})

    def detect(self, parts: Parts, accept: str = "application/json") -> httpx.Response:
        """POST /detect with a form."""
        return self.client.post("/detect", files=parts, headers={"Accept": accept})

    def workers(self, pool: Literal["label", "detect"]) -> list[int]:
        """Process numbers of the workers of a pool that have not ended."""
        return [pid for pid in descendants(self.process.pid) if _name(pid) == f"boxlift-{pool}"]


def descendants(pid: int) -> list[int]:
    """Process numbers of all that a process started, and those started, and so on."""
    children = [
        int(word) for path in Path(f"/proc/{pid}/task").glob("*/children") for word in _text_of(path).split()
    ]
    return children + [pid for child in children for pid in descendants(child)]


def _name(pid: int) -> str:
    return _text_of(Path(f"/proc/{pid}/comm")).strip()


def _text_of(path: Path) -> str:
    """Empty where the process has ended."""
    try:
        return path.read_text()
    except (FileNotFoundError, ProcessLookupError):
        return ""


@contextmanager
def running_service(**variables: str) -> Iterator[RunningService]:
    """`python -m boxlift_service` with BOXLIFT_ variables, from when it is ready; stopped in the end."""
    environment = {**os.environ, "BOXLIFT_PORT": "0"}
    environment |= {f"BOXLIFT_{name.upper()}": value for name, value in variables.items()}
    with subprocess.Popen(
        [sys.executable, "-m", "boxlift_service"],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            url = _listening_url(process)
            with httpx.Client(base_url=url, timeout=60) as client:
                wait_until_ready(client)
                yield RunningService(url, process, client)
        finally:
            _stop(process)


def _stop(process: subprocess.Popen[str]) -> None:
    process.terminate()
    try:
        process.wait(timeout=30)
    except subprocess.TimeoutExpired:
        process.kill()


def _listening_url(process: subprocess.Popen[str]) -> str:
    assert process.stderr is not None
    lines = []
    for line in process.stderr:
        lines.append(line)
        if found := re.search(r"running on (http://\S+)", line):
            # Somebody has to read what it logs, or it blocks once the pipe is full.
            threading.Thread(target=process.stderr.read, daemon=True).start()
            return found[1]
    raise RuntimeError(f"the service ended while it started:\n{''.join(lines)}")


def wait_until_ready(client: httpx.Client) -> None:
    """Return once /readyz says so."""
    end = time.monotonic() + _START_S
    while (response := client.get("/readyz")).status_code != 200:
        if time.monotonic() > end:
            raise RuntimeError(f"not ready after {_START_S:g} s: {response.text}")
        time.sleep(0.1)
