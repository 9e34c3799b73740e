"""Faults that need a service of their own: a disk that fills up, and the end of the service."""

from __future__ import annotations

import asyncio
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from serving import processes
from serving.load_loops import OK, REFUSED
from serving.processes import DETECT, LABEL
from serving.service_process import Service, running_boxlift
from serving.stage import Account, Stage

_ENDS_WITHIN_S = 30.0


@contextmanager
def service_with_small_disks(variables: Mapping[str, str]) -> Iterator[tuple[Service, list[Path]]]:
    """A service whose temporary folders are file systems of 1 MiB of its own, and those as seen from here.

    Raises NotPossibleError where mounting is not allowed.
    """
    with tempfile.TemporaryDirectory() as folder:
        # What the service is loaded from has to stay in sight.
        loaded_from = [Path(one).resolve() for one in (sys.prefix, sys.base_prefix, __file__)]
        hides = any(one.is_relative_to("/tmp") for one in loaded_from)
        places = [Path(folder if hides else "/tmp"), Path("/var/tmp"), Path("/dev/shm")]
        mounts = " && ".join(f"mount -t tmpfs -o size=1m tmpfs {place}" for place in places)
        rights = [] if os.geteuid() == 0 else ["--user", "--map-root-user"]
        unshare = ["unshare", *rights, "--mount", "sh", "-c"]
        if shutil.which("unshare") is None or subprocess.run([*unshare, mounts], check=False).returncode:
            raise NotPossibleError("file systems cannot be mounted here")
        wrapper = [*unshare, f'{mounts} && cd {places[0]} && exec "$@"', "sh"]
        with running_boxlift(variables, [*wrapper, "env", f"TMPDIR={places[0]}"]) as service:
            yield service, [Path(f"/proc/{service.pid}/root{place}") for place in places]


class NotPossibleError(Exception):
    """This machine does not let the fault be made."""


async def disk_full(stage: Stage, places: Sequence[Path]) -> Account:
    """Every temporary folder fills up under load; then each kind of worker is killed, and replaced."""
    account = Account("disk full", times=len(places))

    async def strike(_: Account) -> None:
        for place in places:
            fill(place / "filler")
        await asyncio.sleep(3.0)
        for role in (LABEL, DETECT):
            there = await stage.workers(role)
            for victim in there:
                os.kill(victim, signal.SIGKILL)
                account.may_die += 1
            if not await stage.recovered(account, {role: (there, len(there))}):
                return
        await asyncio.sleep(3.0)

    await stage.under_load(account, strike)
    return account


def fill(path: Path) -> None:
    """Write until nothing more can be written, not a byte."""
    for size in (4096, 1):
        with suppress(OSError), path.open("ab", buffering=0) as file:
            while True:
                file.write(bytes(size))


async def end(stage: Stage, drain_s: float) -> Account:
    """SIGTERM under load: what is sent while it drains is answered, then all processes end."""
    service, account = stage.service, Account(f"SIGTERM under load, {drain_s:g} s to drain", times=1)
    family = [one.pid for one in processes.family(service.pid)]
    told_at = 0.0

    async def strike(_: Account) -> None:
        nonlocal told_at
        told_at = time.perf_counter()
        os.kill(service.pid, signal.SIGTERM)
        await asyncio.sleep(drain_s / 2)
        if drain_s and await stage.is_ready():
            account.wrong.append("/readyz says 200 while it drains")
        with suppress(TimeoutError):
            async with asyncio.timeout(_ENDS_WITHIN_S):
                while service.process.poll() is None:
                    await asyncio.sleep(0.05)
        took_s = time.perf_counter() - told_at
        account.notes.append(f"it ended with {service.process.returncode} after {took_s:.1f} s")

    run = await stage.under_load(account, strike)
    account.answers.clear()
    # From then on a connection may be refused, or closed before its request was read.
    drained_s = told_at + drain_s - run.began - 0.2
    late: Counter[str] = Counter()
    for one in run.outcomes:
        in_time = one.due_s < drained_s or one.verdict in (OK, REFUSED)
        (account.answers if in_time else late)[one.verdict] += 1
    account.notes.append(f"sent too late: {dict(late)}")
    # A process that has done all that SIGTERM asks for may end by it.
    if service.process.returncode not in (0, -signal.SIGTERM):
        account.wrong.append(f"it ended with {service.process.returncode}")
    end_s = time.monotonic() + _ENDS_WITHIN_S
    while (alive := sum(Path(f"/proc/{pid}").exists() for pid in family)) and time.monotonic() < end_s:
        await asyncio.sleep(0.1)
    account.left = {"processes": alive} if alive else {}
    return account
