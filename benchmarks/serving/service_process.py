"""A real service as a process of its own, on loopback."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import httpx

_STARTS_WITHIN_S = 90.0
_STOPS_WITHIN_S = 60.0
_LISTENS = re.compile(r"running on (http://\S+)")


@dataclass(frozen=True)
class Service:
    """A service that is ready. log: what it wrote to stdout and stderr."""

    url: str
    process: subprocess.Popen[bytes]
    log: Path

    @property
    def pid(self) -> int:
        """Process number of the server process."""
        return self.process.pid

    def metrics(self) -> dict[str, float]:
        """Value by series, as GET /metrics writes it; empty where it has no such route."""
        response = httpx.get(f"{self.url}/metrics")
        if response.status_code != 200:
            return {}
        lines = (line for line in response.text.splitlines() if line and not line.startswith("#"))
        return {series: float(value) for series, _, value in (line.rpartition(" ") for line in lines)}


@contextmanager
def running_boxlift(variables: Mapping[str, str], wrapper: Sequence[str] = ()) -> Iterator[Service]:
    """boxlift with BOXLIFT_ variables, from when it is ready; stopped in the end.

    wrapper: a command that ends by executing the arguments that follow it, in its own process.
    """
    settings = {"host": "127.0.0.1", "port": "0", **variables}
    environment = {**os.environ, **{f"BOXLIFT_{name.upper()}": value for name, value in settings.items()}}
    with running([*wrapper, sys.executable, "-m", "boxlift_service"], environment, "/readyz") as service:
        yield service


@contextmanager
def running(
    command: Sequence[str], environment: Mapping[str, str], ready_path: str, url: str | None = None
) -> Iterator[Service]:
    """A service from when `ready_path` answers 200; stopped in the end. Where no `url` is given, its log
    says where it listens, as uvicorn's does. Raises RuntimeError with its log where it does not come up.
    """
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "service.log"
        with log.open("wb") as stream:
            process = subprocess.Popen(
                command,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=stream,
                start_new_session=True,
            )
        try:
            yield _ready(process, log, ready_path, url)
        finally:
            process.terminate()
            with suppress(subprocess.TimeoutExpired):
                process.wait(_STOPS_WITHIN_S)
            # LitServe leaves its workers behind.
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def free_port() -> int:
    """A port of loopback that nobody listens on."""
    with socket.socket() as end:
        end.bind(("127.0.0.1", 0))
        port: int = end.getsockname()[1]
        return port


def _ready(process: subprocess.Popen[bytes], log: Path, ready_path: str, url: str | None) -> Service:
    end = time.monotonic() + _STARTS_WITHIN_S
    while process.poll() is None and time.monotonic() < end:
        time.sleep(0.05)
        if url is None:
            found = _LISTENS.search(log.read_text(errors="replace"))
            url = found[1] if found else None
        elif _answers(f"{url}{ready_path}"):
            return Service(url, process, log)
    what = "is not ready" if process.returncode is None else f"ended with status {process.returncode}"
    raise RuntimeError(f"the service {what}:\n{log.read_text(errors='replace')[-3000:]}")


def _answers(url: str) -> bool:
    try:
        return httpx.get(url).status_code == 200
    except httpx.TransportError:
        return False
