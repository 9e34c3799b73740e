"""How long POST /label takes over loopback, stage by stage: the real service, one frame, again and again.

    python benchmarks/label_http.py [FOLDER] [--prompts label_2] [--objects 5] [--frames 5] [--repeats 30]

FOLDER is a dataset (by default ../shared/kitti/object where it exists, else frames are generated). Taken
are frames with at least that many prompts; the first prompts are sent. Prints, per frame, the median of
each stage (Server-Timing), of the client's wall clock, and of the labeller called in this process.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import count, islice
from pathlib import Path

import httpx
import torch

from boxlift.datasets.generated import generate
from boxlift.datasets.source import load_prompts, open_source
from boxlift.errors import DatasetError
from boxlift.frame import Frame
from boxlift.labeller import Labeller
from boxlift.settings import DEFAULT_PRESET, preset
from boxlift_client.label_request import form_of_frame
from boxlift_client.request_parts import Form
from boxlift_client.service_process import running_service

DEFAULT_FOLDER = Path(__file__).resolve().parents[2] / "shared" / "kitti" / "object"


def frames_of(folder: Path | None, prompts: str, object_count: int) -> Iterator[Frame]:
    """Frames with `object_count` prompts each, from a dataset or generated."""
    candidates = _generated_frames() if folder is None else _frames_on_disk(folder, prompts)
    for frame in candidates:
        if len(frame.prompts) >= object_count:
            yield replace(frame, prompts=frame.prompts[:object_count], image=None, instance_ids=None)


def _generated_frames() -> Iterator[Frame]:
    return (generate(seed).frame for seed in count())


def _frames_on_disk(folder: Path, prompts: str) -> Iterator[Frame]:
    source = open_source(folder)
    for name in source.names:
        try:
            yield source.load(name, load_prompts(prompts, source, name))
        except DatasetError:
            continue  # a frame without LiDAR


def http_seconds(client: httpx.Client, form: Form) -> dict[str, float]:
    """Seconds per stage, as the service says, and `wall`, as this process sees it."""
    start = time.perf_counter()
    response = client.post("/label", files=form)
    wall = time.perf_counter() - start
    response.raise_for_status()
    stages = (stage.split(";dur=") for stage in response.headers["server-timing"].split(", "))
    return {**{name: float(milliseconds) / 1000 for name, milliseconds in stages}, "wall": wall}


def local_seconds(labeller: Labeller, frame: Frame) -> float:
    """Seconds of the labeller alone, in this process."""
    start = time.perf_counter()
    labeller.label(frame)
    return time.perf_counter() - start


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--prompts", default="label_2")
    parser.add_argument("--preset", default=DEFAULT_PRESET)
    parser.add_argument("--objects", type=int, default=5)
    parser.add_argument("--frames", type=int, default=5)
    parser.add_argument("--repeats", type=int, default=30)
    arguments = parser.parse_args()
    folder = arguments.folder or (DEFAULT_FOLDER if DEFAULT_FOLDER.is_dir() else None)
    settings = preset(arguments.preset)
    labeller = Labeller(settings)
    torch.set_num_threads(1)  # as the service's workers do
    machine = f"{platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}"
    print(f"{machine}, torch {torch.__version__}")
    print(f"preset {settings.preset}; medians of {arguments.repeats} runs, milliseconds")
    walls = []
    frames = islice(frames_of(folder, arguments.prompts, arguments.objects), arguments.frames)
    with running_service() as url, httpx.Client(base_url=url, timeout=60) as client:
        for frame in frames:
            form = form_of_frame(frame, settings)
            for _ in range(3):
                http_seconds(client, form)
                local_seconds(labeller, frame)
            runs = [
                {**http_seconds(client, form), "in_process": local_seconds(labeller, frame)}
                for _ in range(arguments.repeats)
            ]
            medians = {name: statistics.median(run[name] for run in runs) for name in runs[0]}
            walls.append(medians["wall"])
            columns = "  ".join(f"{name} {1000 * seconds:.1f}" for name, seconds in medians.items())
            print(f"{frame.name}  {len(frame.points_velo)} points, {len(frame.prompts)} objects:  {columns}")
    if walls:
        print(f"median wall of {len(walls)} frames: {1000 * statistics.median(walls):.1f} ms")


if __name__ == "__main__":
    main()
