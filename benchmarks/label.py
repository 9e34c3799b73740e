"""How long Labeller.label takes, stage by stage, on one core: frames with prompts, again and again.

    python benchmarks/label.py [FOLDER] [--prompts label_2] [--objects 5] [--frames 5] [--repeats 20]

FOLDER is a dataset (by default ../shared/kitti/object where it exists, else frames are generated). Taken
are the first frames with at least that many prompts; the first prompts are labelled. Presets take turns
within each repeat, so that a busy machine slows them alike; the ratio is to `paper` in the same run.
"""

from __future__ import annotations

import argparse
import platform
import statistics
from collections import defaultdict
from itertools import islice
from pathlib import Path

import torch

from boxlift.labeller import Labeller, StageTimes
from boxlift.settings import preset
from label_http import DEFAULT_FOLDER, frames_of

_PRESETS = ("paper", "accurate")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--prompts", default="label_2")
    parser.add_argument("--objects", type=int, default=5)
    parser.add_argument("--frames", type=int, default=5)
    parser.add_argument("--repeats", type=int, default=20)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    folder = arguments.folder or (DEFAULT_FOLDER if DEFAULT_FOLDER.is_dir() else None)
    frames = list(islice(frames_of(folder, arguments.prompts, arguments.objects), arguments.frames))
    points = statistics.median(len(frame.points_velo) for frame in frames)
    print(f"{platform.machine()}, one thread; {len(frames)} frames x {arguments.repeats} repeats,")
    print(f"{arguments.objects} objects each, median of {points:.0f} points; medians in ms")

    stages: dict[str, dict[str, list[float]]] = {name: defaultdict(list) for name in _PRESETS}
    labellers = {name: Labeller(preset(name)) for name in _PRESETS}
    for repeat in range(arguments.repeats + 1):
        for frame in frames:
            for name, labeller in labellers.items():
                times = StageTimes()
                labeller.label(frame, times)
                if repeat:  # the first round warms up
                    for stage, took in times.seconds.items():
                        stages[name][stage].append(took)
                    stages[name]["all"].append(sum(times.seconds.values()))
    for name, by_stage in stages.items():
        print(name)
        for stage, seconds in by_stage.items():
            print(f"  {stage:12} {1000 * statistics.median(seconds):7.1f}")
    ratio = statistics.median(stages["accurate"]["all"]) / statistics.median(stages["paper"]["all"])
    print(f"accurate / paper: {ratio:.2f}")


if __name__ == "__main__":
    main()
