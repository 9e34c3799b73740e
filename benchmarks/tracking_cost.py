"""What tracking costs: time a frame beside labelling it, and memory along a long drive.

    python benchmarks/tracking_cost.py time [--repeats 3]
    python benchmarks/tracking_cost.py memory [--frames 2000]

time: the given real drives (../shared/kitti/sequences), in one process and thread; medians of repeats, and
the ratio to labelling the same frames one by one in the same run. memory: a generated drive, driven there and
back again until it is that long; resident memory of the process as frames are read, pass by pass.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from time import perf_counter

import psutil
import torch

from boxlift.datasets import load_prompts, open_source
from boxlift.datasets.generated import DriveSettings, GeneratedSweep, generate_drive
from boxlift.formats.details import FrameDetails, details_of, view_details_of
from boxlift.frame import Frame, Prompt
from boxlift.labeller import Labeller
from boxlift.settings import ACCURATE
from boxlift.tracking import SweepFrames
from boxlift.tracking.drive import DriveReader, survey
from boxlift.tracking.frame_pass import rewritten_frames
from boxlift.tracking.linking import link
from boxlift.tracking.tracked_objects import tracked_objects
from kitti_drives import LABELS, drives_of, lay_out, log_of, truths_of

_SEED, _SWEEPS = 300, 40
_PERIOD_NS = 100_000_000
_SAMPLES = 10


@dataclass
class _Reader:
    """Labels in memory, frames by a function."""

    labelled: dict[str, FrameDetails]
    read: Callable[[str, tuple[Prompt, ...]], Frame]

    def details(self, name: str) -> FrameDetails:
        return self.labelled[name]

    def load(self, name: str, prompts: tuple[Prompt, ...]) -> Frame:
        return self.read(name, prompts)


class _Clock:
    """Adds the time since it was last asked."""

    def __init__(self, seconds: dict[str, float]) -> None:
        self._seconds = seconds
        self._last = perf_counter()

    def add(self, name: str) -> None:
        now = perf_counter()
        self._seconds[name] = self._seconds.get(name, 0) + now - self._last
        self._last = now


def _passes(sweeps: Sequence[SweepFrames], reader: DriveReader, on_pass: Callable[[str], None]) -> None:
    """The three passes of DriveTracker, told apart."""
    drive = survey(sweeps, reader, "matched")
    on_pass("match and read")
    tracks = link(zip((sweep.time_s for sweep in drive.sweeps), drive.sightings, strict=True))
    on_pass("link")
    objects = tracked_objects(drive.sweeps, tracks, reader, ACCURATE)
    on_pass("gather and fit")
    for _ in rewritten_frames(drive.sweeps, objects, reader, ACCURATE, "gaps"):
        pass
    on_pass("rewrite")


def print_times(repeats: int) -> None:
    """Milliseconds a frame."""
    torch.set_num_threads(1)
    rows: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        source = open_source(lay_out(Path(folder)))
        for _ in range(repeats):
            seconds: dict[str, float] = {}
            frames = 0
            for drive in drives_of():
                names = list(truths_of(drive))
                frames += len(names)
                labeller = Labeller(ACCURATE)
                labelled = {}
                start = perf_counter()
                for name in names:
                    frame = source.load(name, load_prompts(LABELS, source, name))
                    details = details_of(labeller.label(frame))
                    assert frame.view is not None, log_of(drive)
                    labelled[name] = details.model_copy(update={"view": view_details_of(frame.view)})
                seconds["label"] = seconds.get("label", 0) + perf_counter() - start
                sweeps = [SweepFrames((name,), int(name[-10:]) * _PERIOD_NS) for name in names]
                _passes(sweeps, _Reader(labelled, source.load), _Clock(seconds).add)
            for name, value in seconds.items():
                rows.setdefault(name, []).append(1e3 * value / frames)
            track = 1e3 * (sum(seconds.values()) - seconds["label"]) / frames
            rows.setdefault("track, all passes", []).append(track)
            rows.setdefault("ratio of track to label", []).append(track / rows["label"][-1])
    for name, values in rows.items():
        unit = "" if name.startswith("ratio") else "ms a frame"
        print(f"{name:26} {median(values):7.2f} {unit}  (of {', '.join(f'{v:.1f}' for v in values)})")


def print_memory(frames: int) -> None:
    """Resident memory at each tenth of the frames of the last pass, and after the others."""
    made = list(generate_drive(_SEED, settings=DriveSettings(sweeps=_SWEEPS), with_images=False))
    # There and back again: the first and the last sweep are not repeated at the turns.
    loop = [*made, *made[-2:0:-1]]
    labeller = Labeller(ACCURATE)
    once = {each.generated.frame.name: details_of(labeller.label(_plain(each))) for each in made}
    labelled: dict[str, FrameDetails] = {}
    original: dict[str, Frame] = {}
    sweeps = []
    for number in range(frames):
        each = loop[number % len(loop)]
        frame = _plain(each)
        name = f"{number:06d}"
        assert frame.view is not None
        view = view_details_of(replace(frame.view, sweep=name, timestamp_ns=number * _PERIOD_NS))
        labelled[name] = once[frame.name].model_copy(update={"frame": name, "view": view})
        original[name] = frame
        sweeps.append(SweepFrames((name,), number * _PERIOD_NS))
    process = psutil.Process()

    def show(what: str) -> None:
        print(f"{what:24} {process.memory_info().rss / 1e6:8.1f} MB", flush=True)

    def load(name: str, prompts: tuple[Prompt, ...]) -> Frame:
        number = int(name)
        if number % (frames // _SAMPLES) == 0:
            show(f"  frame {number}")
        # As read from a file: an array of its own, that whoever keeps a part of it keeps.
        frame = original[name]
        return replace(frame, prompts=prompts, points_velo=frame.points_velo.copy())

    show("before")
    _passes(sweeps, _Reader(labelled, load), show)


def _plain(sweep: GeneratedSweep) -> Frame:
    return replace(sweep.generated.frame, instance_ids=None, image=None)


def main() -> None:
    """Measure what is asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("time", "memory"))
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--frames", type=int, default=2000)
    arguments = parser.parse_args()
    if arguments.what == "time":
        print_times(arguments.repeats)
    else:
        print_memory(arguments.frames)


if __name__ == "__main__":
    main()
