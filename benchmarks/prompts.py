"""What 2D boxes are worth: recall of cars as prompts get worse than the labels' own.

    python benchmarks/prompts.py [FOLDER]

FOLDER is a dataset in KITTI object layout with label_2. Every edge of a box is moved by a share of the
box's side: outwards (loose), inwards (tight), or at random by so much (standard deviation; seed 0). Recall
counts a truth as found by the box of its own prompt. Beside it what sizes and masks do: a fixed size, and
instance masks on generated frames, which have them.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from ablation import Dataset, generated, kitti, recall_of
from boxlift.frame import Frame, Prompt
from boxlift.settings import ACCURATE, LabellerSettings
from presets import DEFAULT_FOLDER

Change = Callable[[Prompt], Prompt]


def moved(outwards: float, spread: float = 0.0) -> Change:
    """Edges moved outwards by a share of the side, and at random by `spread` of it."""
    random = np.random.default_rng(0)

    def change(prompt: Prompt) -> Prompt:
        x1, y1, x2, y2 = prompt.box_px
        sides = np.array([x2 - x1, y2 - y1, x2 - x1, y2 - y1])
        ways = np.array([-1, -1, 1, 1]) * outwards + random.normal(0, 1, 4) * spread
        a, b, c, d = (np.array(prompt.box_px) + sides * ways).tolist()
        return replace(prompt, box_px=(a, b, c, d))

    return change


def changed(data: Dataset, change: Change, *, masks: bool = False) -> Dataset:
    """The same frames with other prompts, and with their masks or without."""

    def frame_with(frame: Frame) -> Frame:
        ids = frame.instance_ids if masks else None
        return replace(frame, prompts=tuple(map(change, frame.prompts)), instance_ids=ids)

    return replace(data, frames=[frame_with(frame) for frame in data.frames])


def print_row(name: str, data: Dataset, settings: LabellerSettings) -> None:
    """Moderate and hard cars."""
    (_, moderate, hard), *_ = recall_of(settings, data).values()
    for group, recall in (("moderate", moderate), ("hard", hard)):
        cells = "  ".join(f"{value:6.3f}" for value in recall.values)
        print(f"{name:26} {group:8} {recall.cars:4d}  {cells}")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=DEFAULT_FOLDER)
    torch.set_num_threads(1)
    data = kitti(parser.parse_args().folder)
    print(f"{'real frames':26} {'cars':8}    n  bev@.5   3d@.5  bev@.7   3d@.7")
    print_row("as the labels have them", data, ACCURATE)
    for share in (0.05, 0.1):
        print_row(f"looser by {share:.0%} a side", changed(data, moved(share)), ACCURATE)
        print_row(f"tighter by {share:.0%} a side", changed(data, moved(-share)), ACCURATE)
    for share in (0.03, 0.06):
        print_row(f"edges at random, {share:.0%}", changed(data, moved(0, share)), ACCURATE)
    print_row("fixed size", data, ACCURATE.with_options({"repairs": {"size": "fixed"}}))
    scenes = generated(40, first_seed=500)
    print(f"{'40 generated frames':26} {'cars':8}    n  bev@.5   3d@.5  bev@.7   3d@.7")
    for preset in ("accurate", "paper"):
        settings = ACCURATE if preset == "accurate" else LabellerSettings()
        print_row(f"{preset}, boxes", changed(scenes, moved(0)), settings)
        print_row(f"{preset}, boxes and masks", changed(scenes, moved(0), masks=True), settings)


if __name__ == "__main__":
    main()
