"""The service, started from here: besides the command `keys`, the only module that knows its package."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from boxlift.errors import BoxliftError
from boxlift_client.client import Client
from boxlift_client.errors import ServiceStartError

_LISTENS = re.compile(r"running on (http://\S+)")
_LOG_LINES_SHOWN = 15
_STOPS_WITHIN_S = 15.0


def serve(options: Mapping[str, str]) -> None:
    """Serve in this process until it is told to stop. `options` go before BOXLIFT_* variables of that name.

    Raises OptionsError for a value out of range, MissingExtraError without the extra `serve`.
    """
    from boxlift_service import ServiceSettings, run

    run(ServiceSettings.from_environment(_environment(options)))


@contextmanager
def running_service(timeout_s: float = 90.0) -> Iterator[str]:
    """The real service as a process of its own on a free port: its URL, once it can label; stopped after.

    Raises ServiceStartError where it ends, or is not ready within `timeout_s`.
    """
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "service.log"
        with log.open("wb") as stream:
            environment = _environment({"host": "127.0.0.1", "port": "0", "log_level": "info"})
            # The linear algebra of a frame is small: more threads would only wait for each other.
            environment.setdefault("OMP_NUM_THREADS", "1")
            process = subprocess.Popen(
                [sys.executable, "-m", "boxlift_service"],
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=stream,
            )
        try:
            deadline = time.monotonic() + timeout_s
            url = _listening_url(process, log, deadline)
            with Client(url) as client:
                try:
                    client.wait_until_ready(max(0.0, deadline - time.monotonic()))
                except BoxliftError as error:
                    raise ServiceStartError(f"{error}\n{_tail(log)}") from None
            yield url
        finally:
            _stop(process)


def _environment(options: Mapping[str, str]) -> dict[str, str]:
    return {**os.environ, **{f"BOXLIFT_{name.upper()}": value for name, value in options.items()}}


def _listening_url(process: subprocess.Popen[bytes], log: Path, deadline: float) -> str:
    """Where the service listens: it took a free port itself, and its log says which."""
    while True:
        ended = process.poll() is not None
        if match := _LISTENS.search(log.read_text(encoding="utf-8", errors="replace")):
            return match[1]
        if ended:
            raise ServiceStartError(f"The service ended with status {process.returncode}.\n{_tail(log)}")
        if time.monotonic() > deadline:
            raise ServiceStartError(f"The service does not listen yet.\n{_tail(log)}")
        time.sleep(0.05)


def _tail(log: Path) -> str:
    lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
    return "\n".join(lines[-_LOG_LINES_SHOWN:])


def _stop(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(_STOPS_WITHIN_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
