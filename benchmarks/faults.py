"""Faults under load: what happens to the requests, how soon the service is ready again, what is left behind.

    python benchmarks/faults.py [--only kill,stop] [--kills 20] [--short] [--json FILE] [--set NAME=VALUE ...]

A real service on loopback is kept busy with all routes mixed (as in load.py, frames generated) while

    kill     each kind of worker is killed (SIGKILL), 20 times
    stop     a worker is stopped (SIGSTOP), idle and busy
    vanish   clients end or reset the connection in their upload, and while they wait for the answer
    slow     200 uploads at once stall or bring a byte now and then; they are to end with 408
    reload   SIGHUP: the workers with the models are replaced
    disk     every temporary folder fills up (file systems of the service's own; needs mount rights)
    end      SIGTERM: what was accepted is answered, then all processes end

Every request beside these is to be answered: 200, 429 with Retry-After, or, for the one that a worker held
when it was hurt, a 500 of kind worker-died. The service is to be ready again, with all workers, within 10 s;
10 s after the load has ended it is to hold no more processes, zombies, descriptors, memfds and files in
/dev/shm than before the first fault. Ends with status 1 where that is not so.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
from collections.abc import Awaitable, Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

from serving import endings, strikes
from serving.load_loops import OK, REFUSED
from serving.prepared import frames, prepare
from serving.processes import DETECT, LABEL
from serving.report import circumstances, print_circumstances, write_json
from serving.service_process import Service, running_boxlift
from serving.stage import Account, Stage
from serving.strikes import Extent

ON_ONE_SERVICE = ("kill", "stop", "vanish", "slow", "reload")
FAULTS = (*ON_ONE_SERVICE, "disk", "end")

# Slow uploads shall end soon; all else is as the service comes.
_SETTINGS = {"receive_idle_s": "3", "receive_limit_s": "12"}

_WARM_UP_S = 3.0

Fault = Callable[[Stage], Awaitable[Account]]


def chosen_faults(only: Collection[str], extent: Extent, settings: Mapping[str, str]) -> Iterator[Fault]:
    """Those of ON_ONE_SERVICE that are wanted."""
    roles = (LABEL, DETECT)
    if "kill" in only:
        yield from (partial(strikes.kill, role=role, times=extent.kills) for role in roles)
    if "stop" in only:
        yield from (partial(strikes.stop_idle, role=role, times=extent.stops) for role in roles)
        yield from (partial(strikes.stop_busy, role=role, times=extent.stops) for role in roles)
    if "vanish" in only:
        yield partial(strikes.vanish_in_upload, times=extent.vanishing)
        yield partial(strikes.vanish_in_answer, times=extent.vanishing)
    if "slow" in only:
        yield partial(strikes.slow_uploads, how_many=extent.slow, end_s=float(settings["receive_limit_s"]))
    if "reload" in only:
        yield partial(strikes.reload, times=extent.reloads)


async def on_one_service(stage: Stage, faults: Iterable[Fault], accounts: list[Account]) -> None:
    """One fault after the other, as long as the service lives."""
    await stage.warm_up(_WARM_UP_S)
    for fault in faults:
        if stage.service.process.poll() is not None:
            accounts[-1].wrong.append(f"the service ended with {stage.service.process.returncode}")
            return
        account = await fault(stage)
        account.judge()
        print_account(account)
        accounts.append(account)


def run_faults(
    only: Collection[str], extent: Extent, settings: Mapping[str, str], log: Path | None
) -> list[Account]:
    """The accounts of all faults that are wanted."""
    accounts: list[Account] = []
    chosen = frames(None, extent.frames)

    def on(service: Service, *faults: Fault) -> None:
        asyncio.run(on_one_service(Stage(service, prepare(service.url, chosen)), faults, accounts))
        if log is not None:
            with log.open("ab") as stream:
                stream.write(service.log.read_bytes())

    if set(only) & set(ON_ONE_SERVICE):
        with running_boxlift(settings) as service:
            on(service, *chosen_faults(only, extent, settings))
    if "disk" in only:
        try:
            with endings.service_with_small_disks(settings) as (service, places):
                on(service, partial(endings.disk_full, places=places))
        except endings.NotPossibleError as error:
            print(f"disk full: not run, {error}")
    if "end" in only:
        for drain_s in extent.drains_s:
            with running_boxlift({**settings, "drain_s": f"{drain_s:g}"}) as service:
                on(service, partial(endings.end, drain_s=drain_s))
    return accounts


HEADER = (
    f"{'fault':30}{'times':>6}{'requests':>9}{'ok':>6}{'429':>5}{'5xx':>5}{'lost':>5}{'recovery':>9}  left"
)


def print_account(account: Account) -> None:
    """A line of the table, and what there is to say beside."""
    slowest = f"{max(account.recoveries_s):.1f} s" if account.recoveries_s else "-"
    counts = account.answers.total(), account.answers[OK], account.answers[REFUSED], account.server_errors
    columns = "".join(f"{count:{width}}" for count, width in zip(counts, (9, 6, 5, 5), strict=True))
    left = ", ".join(f"{count} {name}" for name, count in account.left.items()) or "0"
    print(f"{account.fault:30}{account.times:6}{columns}{account.lost:5}{slowest:>9}  {left}")
    for sentence in account.notes:
        print(f"  {sentence}")
    for sentence in account.wrong:
        print(f"  WRONG: {sentence}", flush=True)


def main() -> None:
    """Measure, print, and end with status 1 where something was not as it is to be."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", default=",".join(FAULTS), metavar="FAULT,...")
    parser.add_argument("--kills", type=int)
    parser.add_argument("--short", action="store_true", help="each fault once or twice")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--log", type=Path, help="file to which the services' logs are added")
    parser.add_argument("--set", action="append", default=[], metavar="SETTING=VALUE")
    arguments = parser.parse_args()
    only = arguments.only.split(",")
    if unknown := set(only) - set(FAULTS):
        parser.error(f"--only: {', '.join(sorted(unknown))} is none of {', '.join(FAULTS)}")
    extent = Extent.short() if arguments.short else Extent()
    if arguments.kills is not None:
        extent = replace(extent, kills=arguments.kills)
    settings = {**_SETTINGS, **dict(one.split("=", 1) for one in arguments.set)}
    told = circumstances(settings)
    print_circumstances(told)
    print(HEADER, flush=True)
    accounts = run_faults(only, extent, settings, arguments.log)
    write_json(arguments.json, {**told, "faults": [account.told() for account in accounts]})
    sys.exit(1 if any(account.wrong for account in accounts) else 0)


if __name__ == "__main__":
    main()
