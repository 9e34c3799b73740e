"""Load on the service, all routes mixed: what it can do, how it answers below that, and at three times it.

    python benchmarks/load.py [FOLDER] [--soak 600] [--short] [--json FILE] [--set label_workers=2 ...]

A real service on loopback gets POST /label with prompts (40 %), POST /label without (20 %) and POST /detect
(40 %), for frames of a dataset FOLDER or generated ones, with 5 objects each. Steps:

1. capacity: closed loops of 2, 4 and 8 connections; the best is the peak. Where wrk is installed it makes the
   same closed loop with the same bytes, beside ours.
2. open loops with Poisson arrivals at half and at 0.8 of the peak, where no request may fail or be refused.
3. closed loops at the peak and open loops at three times it, in turn: throughput is to stay within 10 % of
   the peak (ratio of medians), and every answer that is no success is to be a 429 with Retry-After.
4. --soak: 0.8 of the peak for so many seconds; what the processes hold is read from /proc, and the resident
   set at the end is to lie within 5 % of that after a minute.

Prints ok/s (answers 200 a second), latencies of answers 200 from when a request was due, and what else came.
Ends with status 1 where something was not as it is to be.

Why no load tool makes the open loop: wrk, hey and ab only know closed ones, locust's users wait for their
answers, and their latencies leave out what a stall kept from being sent. The generator sends bytes made
beforehand, in this process, which shares the cores with the service: what it takes of them is printed.
"""

from __future__ import annotations

import argparse
import asyncio
import statistics
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from serving import processes, wrk
from serving.load_loops import OK, Load, Run
from serving.prepared import MIX, frames, mixed, prepare
from serving.report import RUN_HEADER, circumstances, print_circumstances, print_run, summary, write_json
from serving.service_process import Service, running_boxlift

CONNECTIONS = (2, 4, 8)
_HOLDS_WITHIN = 0.1
_FLAT_WITHIN = 0.05
_SAMPLE_EVERY_S = 2.0


@dataclass(frozen=True)
class Plan:
    """Seconds of each step; rounds of step 3."""

    warm_up: float = 6
    closed: float = 20
    wrk: float = 20
    below: float = 60
    rounds: int = 3
    round: float = 20

    @classmethod
    def short(cls, seconds: float) -> Plan:
        """So many for every step, for a first impression."""
        return cls(warm_up=seconds, closed=seconds, wrk=0, below=seconds, rounds=1, round=seconds)


@dataclass
class Findings:
    """What is told in the end. wrong: sentences on what was not as it is to be."""

    told: dict[str, Any]
    wrong: list[str] = field(default_factory=list)

    def expect(self, holds: bool, sentence: str) -> None:
        """Note a sentence that does not hold."""
        if not holds:
            self.wrong.append(sentence)


class Bench:
    """The steps, on one service."""

    def __init__(self, service: Service, load: Load, findings: Findings) -> None:
        self._service = service
        self._load = load
        self._findings = findings

    async def closed(self, connections: int, seconds: float) -> Run:
        """A closed loop, told."""
        return await self._told(f"closed, {connections} connections", self._load.closed(connections, seconds))

    async def open(self, name: str, per_second: float, seconds: float) -> Run:
        """An open loop, told."""
        run = await self._told(f"open, {name} = {per_second:.1f}/s", self._load.open(per_second, seconds))
        self._findings.expect(run.errors == 0, f"{name}: {run.errors} errors")
        return run

    async def _told(self, name: str, loop: Any) -> Run:
        served_before = processes.cpu_seconds(self._service.pid)
        run: Run = await loop
        cpu_s = processes.cpu_seconds(self._service.pid) - served_before
        print_run(name, run, list(MIX))
        cores = f"service {cpu_s / run.seconds:.2f}, generator {run.generator_cpu_s / run.seconds:.2f} cores"
        print(f"  {cores}", flush=True)
        steps = self._findings.told.setdefault("steps", [])
        kinds = {kind: summary(run, kind) for kind in MIX}
        steps.append({"step": name, "seconds": run.seconds, "cores": cores, **summary(run), "kinds": kinds})
        return run


async def measure(service: Service, load: Load, plan: Plan, soak_s: float, findings: Findings) -> None:
    """All steps."""
    bench = Bench(service, load, findings)
    await load.closed(4, plan.warm_up)
    print(RUN_HEADER)
    by_connections = {count: (await bench.closed(count, plan.closed)).per_second() for count in CONNECTIONS}
    best = max(by_connections, key=by_connections.__getitem__)
    peak = by_connections[best]
    findings.told["peak"] = {"connections": best, "per_second": round(peak, 2)}

    for share in (0.5, 0.8):
        run = await bench.open(f"{share} x peak", share * peak, plan.below)
        refused = len(run.outcomes) - run.verdicts[OK]
        findings.expect(refused == 0, f"{share} x peak: {refused} requests were not answered with 200")

    at_peak, beyond = [], []
    for _ in range(plan.rounds):
        at_peak.append((await bench.closed(best, plan.round)).per_second())
        beyond.append((await bench.open("3 x peak", 3 * peak, plan.round)).per_second())
    ratio = statistics.median(beyond) / statistics.median(at_peak)
    print(f"throughput at 3 x peak / at the peak: {ratio:.2f}")
    findings.told["three_times"] = {"at_peak": at_peak, "beyond": beyond, "ratio": round(ratio, 3)}
    findings.expect(ratio >= 1 - _HOLDS_WITHIN, f"3 x peak: throughput falls to {ratio:.2f} of the peak")
    if soak_s:
        await soak(bench, service, 0.8 * statistics.median(at_peak), soak_s, findings)


async def soak(bench: Bench, service: Service, per_second: float, seconds: float, findings: Findings) -> None:
    """Load for long, while what the processes hold is sampled."""
    samples: list[dict[str, Any]] = []

    async def watch() -> None:
        while True:
            samples.append(await asyncio.to_thread(sample, service.pid, time.monotonic() - start))
            await asyncio.sleep(_SAMPLE_EVERY_S)

    start = time.monotonic()
    watching = asyncio.create_task(watch())
    run = await bench.open("soak at 0.8 x peak", per_second, seconds)
    watching.cancel()
    findings.expect(run.verdicts[OK] == len(run.outcomes), f"soak: {dict(run.verdicts)}")
    early = _between(samples, 0.1 * seconds - 10, 0.1 * seconds + 10)
    late = _between(samples, seconds - 20, seconds)
    print(f"{'':10}{'MiB after':>12}{0.1 * seconds:6.0f} s{seconds:10.0f} s")
    for role in early:
        print(f"{role:22}{early[role]:8.0f}{late[role]:12.0f}   {late[role] / early[role] - 1:+.1%}")
    findings.told["soak"] = {"early_mib": early, "late_mib": late, "samples": samples}
    grown = late["rss, all"] / early["rss, all"] - 1
    findings.expect(abs(grown) <= _FLAT_WITHIN, f"soak: the resident set changed by {grown:+.1%}")


def sample(server: int, at_s: float) -> dict[str, Any]:
    """Memory of each role (MiB), and what else the service holds."""
    mib: dict[str, float] = {}
    for pid, role in processes.roles(server).items():
        resident, part = processes.resident_bytes(pid) / 2**20, processes.proportional_bytes(pid) / 2**20
        for name, value in ((f"rss, {role}", resident), ("rss, all", resident), ("pss, all", part)):
            mib[name] = mib.get(name, 0.0) + value
    level = processes.level(server)
    return {"at_s": round(at_s, 1), "mib": mib, "level": vars(level)}


def _between(samples: list[dict[str, Any]], begin_s: float, end_s: float) -> dict[str, float]:
    """Medians by name of what was sampled meanwhile; of all samples where none was."""
    chosen = [one["mib"] for one in samples if begin_s <= one["at_s"] <= end_s] or [
        one["mib"] for one in samples
    ]
    return {name: statistics.median(one.get(name, 0.0) for one in chosen) for name in chosen[0]}


def main() -> None:
    """Measure, print, and end with status 1 where something was not as it is to be."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--frames", type=int, default=4)
    parser.add_argument("--soak", type=float, default=0, metavar="SECONDS")
    parser.add_argument("--short", type=float, nargs="?", const=3.5, metavar="SECONDS", help="of each step")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--set", action="append", default=[], metavar="SETTING=VALUE")
    arguments = parser.parse_args()
    settings = dict(one.split("=", 1) for one in arguments.set)
    plan = Plan() if arguments.short is None else Plan.short(arguments.short)
    findings = Findings(circumstances(settings))
    print_circumstances(findings.told)
    chosen = frames(arguments.folder, arguments.frames)
    points = statistics.median(len(frame.points_velo) for frame in chosen)
    print(f"{len(chosen)} frames, median of {points:.0f} points; mix {MIX}")
    with running_boxlift(settings) as service:
        made = prepare(service.url, chosen)
        load = Load(service.url, mixed(made))
        asyncio.run(measure(service, load, plan, arguments.soak, findings))
        if plan.wrk and wrk.is_installed():
            connections = findings.told["peak"]["connections"]
            findings.told["wrk"] = wrk.closed_loop(service.url, mixed(made), connections, plan.wrk)
            print(f"wrk, closed, {connections} connections: {findings.told['wrk']}")
    findings.told["wrong"] = findings.wrong
    write_json(arguments.json, findings.told)
    for sentence in findings.wrong:
        print(f"WRONG: {sentence}")
    sys.exit(1 if findings.wrong else 0)


if __name__ == "__main__":
    main()
