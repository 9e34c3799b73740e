"""How long KITTI's average precision of 4,000 frames takes, reading included.

    python benchmarks/evaluator.py [FOLDER] [--repeats N]

FOLDER holds label_2/ and pred/ (by default ../shared/oracle/kitti_eval); its frames are copied under new
names until there are 4,000. Prints the median over N runs; single-threaded, files in the page cache.
"""

from __future__ import annotations

import argparse
import os
import platform
import shutil
import statistics
import tempfile
import time
from pathlib import Path

from boxlift.evaluation import BENCHMARK_CLASSES, KittiBenchmark, evaluate_folders
from boxlift.evaluation.label_table import read_table

FRAMES = 4000
_DEFAULT_FOLDER = Path(__file__).resolve().parents[2] / "shared" / "oracle" / "kitti_eval"


def copy_frames(source: Path, target: Path, count: int) -> list[str]:
    """`count` frames under new names, the given ones over and over."""
    given = sorted(path.stem for path in (source / "label_2").glob("*.txt"))
    names = [f"{index // len(given):02d}_{given[index % len(given)]}" for index in range(count)]
    for part in ("label_2", "pred"):
        (target / part).mkdir()
        for index, name in enumerate(names):
            shutil.copyfile(source / part / f"{given[index % len(given)]}.txt", target / part / f"{name}.txt")
    return names


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, nargs="?", default=_DEFAULT_FOLDER)
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    if not (arguments.folder / "label_2").is_dir():
        raise SystemExit(f"{arguments.folder} has no label_2/: nothing measured.")

    seconds: dict[str, list[float]] = {
        "reading": [],
        "overlaps": [],
        "AP and AOS": [],
        "evaluate_folders": [],
    }
    with tempfile.TemporaryDirectory() as scratch:
        copies = Path(scratch)
        names = copy_frames(arguments.folder, copies, FRAMES)
        for _ in range(arguments.repeats):
            start = time.perf_counter()
            truths, detections = read_table(copies / "label_2", names), read_table(copies / "pred", names)
            read = time.perf_counter()
            benchmark = KittiBenchmark(truths, detections)
            overlapped = time.perf_counter()
            for category in BENCHMARK_CLASSES:
                benchmark.average_precision(category)
            judged = time.perf_counter()
            evaluate_folders(copies / "label_2", copies / "pred")
            end = time.perf_counter()
            for stage, duration in zip(
                seconds, (read - start, overlapped - read, judged - overlapped, end - judged), strict=True
            ):
                seconds[stage].append(duration)

    print(f"{FRAMES} frames, {len(truths)} truths, {len(detections)} detections")
    print(f"Python {platform.python_version()}, {platform.machine()}, {os.cpu_count()} CPUs")
    for stage, durations in seconds.items():
        print(f"{stage:18s} median {statistics.median(durations):6.2f} s of {len(durations)}")


if __name__ == "__main__":
    main()
