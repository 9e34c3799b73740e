"""How smoothly the review page draws: frames a second of its 3D view while it turns, in headless Chromium.

    python benchmarks/review_page.py [--objects 300] [--points 200000]

Also how long a frame takes from the key press to its picture. A machine without a GPU draws in software
(SwiftShader), on the cores that also run the service: what a reviewer's laptop does is faster.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np
from playwright.sync_api import expect, sync_playwright

from boxlift.datasets.generated import generate, write_dataset
from boxlift.formats.details import FrameDetails
from boxlift.label_sets.files import write_label_files
from boxlift.label_sets.index import read_details
from boxlift_client.engines.local import LocalEngine
from boxlift_client.job import LabelJob
from boxlift_client.runner import label_dataset
from boxlift_client.service_process import running_service

_SWITCHES = ["--no-sandbox", "--enable-unsafe-swiftshader", "--disable-background-networking"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--objects", type=int, default=300)
    parser.add_argument("--points", type=int, default=200_000)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--repeats", type=int, default=5)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        labels = _crowded_label_set(Path(folder), given.objects, given.points)
        rates, opened = _measured(labels, given.seconds, given.repeats)
    print(f"{platform.machine()}, {len(os.sched_getaffinity(0))} cores, no GPU used")
    print(f"{given.objects} objects, {given.points} points, 1366 x 768, medians of {given.repeats}:")
    print(f"  3D view while it turns: {statistics.median(rates):.1f} frames a second {_spread(rates)}")
    print(f"  from a key to the next frame's picture: {statistics.median(opened):.2f} s {_spread(opened)}")


def _spread(values: list[float]) -> str:
    return f"({min(values):.2f} to {max(values):.2f})"


def _crowded_label_set(folder: Path, objects: int, points: int) -> Path:
    """Two generated frames whose objects and points are repeated until there are as many."""
    dataset, labels = folder / "dataset", folder / "labels"
    names = write_dataset(dataset, (generate(seed) for seed in range(2)))
    label_dataset(LabelJob(dataset, labels, "label_2"), LocalEngine(1))
    rng = np.random.default_rng(0)
    for name in names:
        path = dataset / "training" / "velodyne" / f"{name}.bin"
        sweep = np.fromfile(path, "<f4").reshape(-1, 4)
        more = sweep[rng.integers(len(sweep), size=points)]
        more[:, :3] += rng.normal(scale=0.05, size=(points, 3)).astype("<f4")
        more.tofile(path)
        details = read_details(labels / "details" / f"{name}.json")
        boxes = [item for item in details.objects if item.box is not None]
        crowd = [boxes[index % len(boxes)].model_copy(update={"index": index}) for index in range(objects)]
        write_label_files(labels, name, FrameDetails(frame=name, objects=tuple(crowd)))
    return labels


def _measured(labels: Path, seconds: float, repeats: int) -> tuple[list[float], list[float]]:
    """Frames a second, and seconds from `n` to another frame's title and picture."""
    rates, opened = [], []
    os.environ["BOXLIFT_LABEL_SETS"] = str(labels)
    with running_service() as url, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=_SWITCHES)
        page = browser.new_page(viewport={"width": 1366, "height": 768})
        names = sorted(path.stem for path in (labels / "details").glob("*.json"))
        page.goto(f"{url}/#set={labels.name}&frame={names[0]}&object=0")
        expect(page.locator("#object-title")).to_contain_text(names[0])
        for repeat in range(repeats):
            rates.append(page.evaluate(f"boxlift.measureFrameRate({seconds})"))
            name = names[(repeat + 1) % 2]
            start = time.perf_counter()
            page.evaluate(f"location.hash = {json.dumps(f'set={labels.name}&frame={name}&object=0')}")
            expect(page.locator("#object-title")).to_contain_text(name)
            opened.append(time.perf_counter() - start)
        browser.close()
    return rates, opened


if __name__ == "__main__":
    main()
