"""Runs over whole data sets: pace by workers, what bad frames cost, and memory.

    python benchmarks/dataset_runs.py pace [--frames 600] [--repeats 3] [--workers 1 2]
    python benchmarks/dataset_runs.py engines [--frames 600] [--repeats 3]
    python benchmarks/dataset_runs.py bad [--frames 1000] [--repeats 3]
    python benchmarks/dataset_runs.py memory [--frames 20000]
    python benchmarks/dataset_runs.py ledger [--frames 1000000]
    python benchmarks/dataset_runs.py listing [--frames 100000]

Frames are those of ../shared/kitti/object where it exists, else generated; there are fewer files than frames:
the same ones come again under other names (hard links). Prompts are label_2. Every run is the command line,
from disk to label files.

pace: frames a second from the first label file to the last, so that starting workers does not count, and the
whole run; median of the repeats. Then one worker's time by stage.
engines: as pace, two processes against two actors of a Ray cluster that is started for the run.
bad: the same frames with four bad ones among them (a directory instead of points, which raises; a named pipe,
which hangs; a truncated point cloud; a calibration that is missing), against the run without.
memory: resident memory of runner and workers over the run; the second half against the first.
ledger: rows of so many frames in parts of 1,000, as many machines leave them; what a run that finds all done
takes to read them, and its memory.
listing: names of a data set in KITTI object layout whose files are empty.
"""

from __future__ import annotations

import argparse
import os
import platform
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path

import psutil

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from boxlift.datasets import open_source
from boxlift_client.job import FrameReport, FrameStore, LabelJob, Outcome
from boxlift_client.ledger import LedgerRow, LedgerWriter, read_ledger
from clients.killed_runs import BOXLIFT, write_many_frames
from label_http import DEFAULT_FOLDER

_FRAMES = {
    **{"pace": 600, "engines": 600, "bad": 1000, "memory": 20_000},
    **{"ledger": 1_000_000, "listing": 100_000},
}
_SCENES = 40
_PARTS = ("velodyne", "image_2", "calib", "label_2")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=tuple(_FRAMES))
    parser.add_argument("--frames", type=int)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    arguments = parser.parse_args()
    frames = arguments.frames or _FRAMES[arguments.what]
    print(f"{platform.machine()}, {len(os.sched_getaffinity(0))} cores; {frames} frames")
    if arguments.what in ("ledger", "listing"):
        (_ledger if arguments.what == "ledger" else _listing)(frames)
        return
    with tempfile.TemporaryDirectory(dir=os.environ.get("BOXLIFT_SCRATCH")) as folder:
        data = Path(folder) / "data"
        _write_frames(data, frames)
        if arguments.what == "pace":
            arms: dict[str, tuple[object, ...]] = {
                f"{count} workers": ("--workers", count) for count in arguments.workers
            }
            _pace(data, Path(folder), frames, arms, arguments.repeats)
            _stages(data, Path(folder) / "stages")
        elif arguments.what == "engines":
            arms = {"local": ("--workers", 2), "ray": ("--engine", "ray", "--workers", 2)}
            paces = _pace(data, Path(folder), frames, arms, arguments.repeats)
            extra_ms = 1000 * (1 / paces["ray"] - 1 / paces["local"])
            print(f"Ray, against processes: {2 * extra_ms:+.2f} ms a frame of an actor")
        elif arguments.what == "bad":
            _bad(data, Path(folder), frames, arguments.repeats)
        else:
            _memory(data, Path(folder), frames)


def _write_frames(root: Path, count: int) -> None:
    if not DEFAULT_FOLDER.is_dir():
        print("frames: generated")
        write_many_frames(root, count, _SCENES)
        return
    print("frames: KITTI")
    split = DEFAULT_FOLDER / "training"
    names = sorted(path.stem for path in (split / "velodyne").iterdir())
    for part in _PARTS:
        (root / "training" / part).mkdir(parents=True)
        kept: dict[Path, Path] = {}
        for index in range(count):
            original = next((split / part).glob(f"{names[index % len(names)]}.*"))
            path = root / "training" / part / f"{index:06d}{original.suffix}"
            if original in kept:
                os.link(kept[original], path)
            else:
                shutil.copy(original, path)
                kept[original] = path


def _label(data: Path, out: Path, *arguments: object, check: bool = True) -> tuple[float, float, int]:
    """Frames a second between the first and the last label file, seconds of the run, and its exit status."""
    command = [*BOXLIFT, "label", str(data), "--out", str(out), "--prompts", "label_2", *map(str, arguments)]
    start = time.perf_counter()
    ran = subprocess.run(command, check=False, capture_output=True, text=True)
    took_s = time.perf_counter() - start
    if check and ran.returncode:
        sys.exit(ran.stderr)
    written = sorted(path.stat().st_mtime for path in (out / "data").iterdir())
    return (len(written) - 1) / (written[-1] - written[0]), took_s, ran.returncode


def _pace(
    data: Path, scratch: Path, frames: int, arms: Mapping[str, Sequence[object]], repeats: int
) -> dict[str, float]:
    """Runs with the options of each arm by turns; returns the median pace at work of each."""
    paces: defaultdict[str, list[float]] = defaultdict(list)
    wholes: defaultdict[str, list[float]] = defaultdict(list)
    for repeat in range(repeats):
        for number, (name, options) in enumerate(arms.items()):
            out = scratch / f"out-{repeat}-{number}"
            pace, took_s, _ = _label(data, out, *options)
            paces[name].append(pace)
            wholes[name].append(frames / took_s)
            shutil.rmtree(out)
    print("                frames/s at work  frames/s of the whole run")
    for name in arms:
        pace, whole = statistics.median(paces[name]), statistics.median(wholes[name])
        print(f"{name:14}  {pace:16.1f}  {whole:25.1f}")
    return {name: statistics.median(values) for name, values in paces.items()}


def _stages(data: Path, out: Path) -> None:
    """Where one worker's time goes, ms a frame; torch in one thread, as in every worker."""
    import torch

    from boxlift.formats.details import FrameDetails, details_of
    from boxlift.frame import Frame
    from boxlift.labeller import Labeller, StageTimes

    torch.set_num_threads(1)
    labeller = Labeller()
    rows: defaultdict[str, float] = defaultdict(float)

    def label(frame: Frame) -> FrameDetails:
        times = StageTimes()
        start = time.perf_counter()
        details = details_of(labeller.label(frame, times))
        rows["label"] += time.perf_counter() - start
        for stage, seconds in times.seconds.items():
            rows[f"  {stage}"] += seconds
        return details

    store = FrameStore(LabelJob(data, out, "label_2"))
    names = [f"{index:06d}" for index in range(120)]
    for name in names[:5]:
        label(store.load(name).given_frame)
    rows.clear()
    for name in names:
        start = time.perf_counter()
        loaded = store.load(name)
        rows["load"] += time.perf_counter() - start
        if loaded.frame is None:
            continue
        details = label(loaded.frame)
        start = time.perf_counter()
        store.finish(loaded, details, 0.0)
        rows["write and fsync"] += time.perf_counter() - start
    print("one worker, ms a frame (mean of 120):")
    for stage, seconds in rows.items():
        print(f"  {stage:18} {1000 * seconds / len(names):6.1f}")


def _bad(data: Path, scratch: Path, frames: int, repeats: int) -> None:
    bad = scratch / "bad"
    shutil.copytree(data, bad, copy_function=os.link)
    split = bad / "training"
    raises, hangs, corrupt, missing = (f"{frames * part // 5:06d}" for part in (1, 2, 3, 4))
    for name in (raises, hangs, corrupt):
        (split / "velodyne" / f"{name}.bin").unlink()
    (split / "velodyne" / f"{raises}.bin").mkdir()
    os.mkfifo(split / "velodyne" / f"{hangs}.bin")
    (split / "velodyne" / f"{corrupt}.bin").write_bytes(b"\0" * 1234567)
    (split / "calib" / f"{missing}.txt").unlink()
    good_s, bad_s = [], []
    for repeat in range(repeats):
        good_s.append(_label(data, scratch / f"good-{repeat}", "--workers", 2)[1])
        out = scratch / f"bad-{repeat}"
        _, took_s, status = _label(bad, out, "--workers", 2, check=False)
        bad_s.append(took_s)
        labels = len(list((out / "data").iterdir()))
        failed = read_ledger(out / "ledger").failed
        print(f"labels {labels}, sentences {len(failed)}, exit status {status}, {took_s:.1f} s", end="")
        print(f" (without bad frames {good_s[-1]:.1f} s)")
    for name, (_, sentence) in sorted(failed.items()):
        print(f"  {name}: {sentence}")
    ratio = statistics.median(bad_s) / statistics.median(good_s)
    print(f"time with / without, medians of {repeats}: {ratio:.3f}")


def _memory(data: Path, scratch: Path, frames: int) -> None:
    out = scratch / "out"
    command = [*BOXLIFT, "label", str(data), "--out", str(out), "--prompts", "label_2", "--workers", "2"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    samples: list[tuple[int, int, int]] = []
    while process.poll() is None:
        time.sleep(2.0)
        done = sum(1 for _ in os.scandir(out / "data")) if (out / "data").is_dir() else 0
        try:
            runner = psutil.Process(process.pid)
            others = sum(child.memory_info().rss for child in runner.children(recursive=True))
            samples.append((done, runner.memory_info().rss, others))
        except psutil.NoSuchProcess:
            continue
    print("frames done   runner MiB   its processes MiB")
    for step in range(1, 11):
        near = min(samples, key=lambda sample: abs(sample[0] - frames * step / 10))
        print(f"{near[0]:11d}  {near[1] / 2**20:11.1f}  {near[2] / 2**20:18.1f}")
    # Tenths of the run: the first warms up.
    early = [sample for sample in samples if frames * 0.1 <= sample[0] < frames * 0.55]
    late = [sample for sample in samples if frames * 0.55 <= sample[0] < frames]
    for index, who in ((1, "runner"), (2, "its processes")):
        growth = statistics.mean(s[index] for s in late) / statistics.mean(s[index] for s in early) - 1
        print(f"{who}: second half against first (from a tenth on): {100 * growth:+.1f} %")


def _ledger(frames: int) -> None:
    process = psutil.Process()
    with tempfile.TemporaryDirectory() as folder:
        for begin in range(0, frames, 1000):
            writer = LedgerWriter(Path(folder))
            for index in range(begin, min(begin + 1000, frames)):
                done = FrameReport(
                    f"{index:010d}", Outcome.LABELLED, results=(("FITTED", ""),), digest="0" * 64
                )
                writer.add(LedgerRow.of(done, "01234567", 1))
            writer.flush()
        before, start = process.memory_info().rss, time.perf_counter()
        state = read_ledger(Path(folder), "01234567")
        took_s, grown = time.perf_counter() - start, process.memory_info().rss - before
        size = sum(path.stat().st_size for path in Path(folder).iterdir())
    print(f"{len(state.done)} rows, {size / 1e6:.0f} MB on disk: read in {took_s:.1f} s", end="")
    print(f", {grown / 1e6:.0f} MB of memory")


def _listing(frames: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        for part, suffix in (("velodyne", ".bin"), ("calib", ".txt"), ("image_2", ".png")):
            (Path(folder) / "training" / part).mkdir(parents=True)
            for index in range(frames):
                (Path(folder) / "training" / part / f"{index:08d}{suffix}").touch()
        start = time.perf_counter()
        names = open_source(Path(folder)).names
        print(f"{len(names)} names in {time.perf_counter() - start:.1f} s")


if __name__ == "__main__":
    main()
