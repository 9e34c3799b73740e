"""How long POST /detect takes over loopback, stage by stage: the real service, one image, again and again.

    python benchmarks/detect_http.py [--image FILE --calib FILE] [--model FILE] [--threads 2] [--repeats 60]

Without --image a frame of 1242 x 375 is generated and sent as PNG. --model is an ONNX file like
BOXLIFT_MODEL, by default the model that ships. Prints, in milliseconds, the median and the quartiles of each
stage as the service tells it (Server-Timing), of the client's wall clock, and of the model alone in this
process.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import subprocess
import time
from pathlib import Path

import httpx

from boxlift import extras
from boxlift.datasets.generated import generate
from boxlift.formats.calibration import read_calibration
from boxlift.formats.image import decode_image
from boxlift.monocular import Monocular
from boxlift.stage_times import StageTimes
from boxlift_client.detect_request import parts_of_files, parts_of_image
from boxlift_client.request_parts import Parts
from boxlift_client.service_process import running_service

_WARM_UPS = 5


def http_seconds(client: httpx.Client, parts: Parts) -> dict[str, float]:
    """Seconds per stage, as the service says, and `wall`, as this process sees it."""
    start = time.perf_counter()
    response = client.post("/detect", files=parts)
    wall = time.perf_counter() - start
    response.raise_for_status()
    stages = (stage.split(";dur=") for stage in response.headers["server-timing"].split(", "))
    return {**{name: float(milliseconds) / 1000 for name, milliseconds in stages}, "wall": wall}


def commit() -> str:
    """The commit of this checkout; `-dirty` where files differ from it."""
    command = ["git", "describe", "--always", "--dirty"]
    folder = Path(__file__).parent
    ran = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    return ran.stdout.strip() or "unknown"


def print_quartiles(seconds: dict[str, list[float]]) -> None:
    """One line per stage: median, quartiles, share of the wall clock's median."""
    wall_ms = 1000 * statistics.median(seconds["wall"])
    for name, values in seconds.items():
        low, median, high = (1000 * value for value in statistics.quantiles(values, n=4))
        print(f"{name:12} {median:7.1f}  ({low:.1f} to {high:.1f})  {median / wall_ms:4.0%}")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--image", type=Path)
    parser.add_argument("--calib", type=Path)
    parser.add_argument("--model", type=Path)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=60)
    arguments = parser.parse_args()
    if (arguments.image is None) != (arguments.calib is None):
        parser.error("--image and --calib go together")

    if arguments.image is None:
        frame = generate(0).frame
        assert frame.image is not None
        image, calibration = frame.image, frame.calibration
        parts = parts_of_image(image, calibration, None, None, frame.name)
    else:
        image = decode_image(arguments.image)
        calibration = read_calibration(arguments.calib, camera_only=True).calibration
        parts = parts_of_files([arguments.image], [arguments.calib], None, None, None)
    model = Monocular.open(arguments.model, arguments.threads)
    os.environ["BOXLIFT_DETECT_THREADS"] = str(arguments.threads)
    if arguments.model is not None:
        os.environ["BOXLIFT_MODEL"] = str(arguments.model)

    height, width, _ = image.shape
    size = len(parts[0][1][1])
    print(f"{platform.machine()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}; commit {commit()}")
    runtime = extras.onnxruntime().__version__
    print(f"onnxruntime {runtime}, {arguments.threads} threads; {model.name} {model.digest[:12]}")
    print(f"{width} x {height} pixels, {size} bytes; milliseconds, {arguments.repeats} runs")
    print("stage         median    (quartiles)   share")
    seconds: dict[str, list[float]] = {}
    with running_service() as url, httpx.Client(base_url=url, timeout=60) as client:
        for repeat in range(_WARM_UPS + arguments.repeats):
            run = http_seconds(client, parts)
            times = StageTimes()
            model.detect("here", image, calibration, times=times)
            run["alone"] = times.seconds["network"]
            if repeat >= _WARM_UPS:
                for name, value in run.items():
                    seconds.setdefault(name, []).append(value)
    print_quartiles(seconds)
    print("receive ... total: the service; wall: the client; alone: the network in this process")


if __name__ == "__main__":
    main()
