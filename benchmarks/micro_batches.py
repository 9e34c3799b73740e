"""Would it pay to compute several requests in one call? Images in a batch, frames at once; milliseconds each.

    python benchmarks/micro_batches.py [--repeats 15] [--json FILE]

POST /detect: the convolutions of the model that ships (trunk and head; the file itself takes one image) with
k images of one size in a batch, against k calls in a row, and against a call on every core with one thread.
POST /label: generated frames of 5 objects, labelled one by one, and k at a time by k processes; then the
stages of a frame of 10 objects and of one of 5. A stage that takes as long for 10 as for 5 would come at half
the price where two frames were fitted in one call; one that takes twice as long gains nothing.

All take turns within each repeat; printed are medians of milliseconds per image or frame. A batch pays only
where it is clearly faster than single calls with the same threads.

Found on two cores (a1b300d): images in batches of 2 and 4 take 45.3 and 46.5 ms each, single ones 46.8. That
is nothing to gain for what waiting for a batch costs. Of a frame, 10 objects take twice as long as 5 in every
stage that depends on them; fitting two frames in one call would save little: fit and polish, the stages that
are batched, are a sixth of a frame. So the service computes each request alone.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import statistics
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch

from boxlift import extras
from boxlift.datasets.generated import generate
from boxlift.frame import Frame
from boxlift.labeller import Labeller, StageTimes
from boxlift.monocular import DEFAULT_PATH
from serving.prepared import OBJECTS, frames
from serving.report import circumstances, print_circumstances, write_json

BATCHES = (1, 2, 4)
_SIDES = (384, 1248)
_FRAMES = 4

Work = Callable[[], object]


def convolutions(path: Path) -> tuple[bytes, str]:
    """The part of a model between its first convolution and those of its head, which takes a batch; and the
    name of its input, (N, 3, H, W).
    """
    model = onnx.load(path)
    layers = [node for node in model.graph.node if node.op_type == "Conv"]
    first = layers[0].input[0]
    outputs = [node.output[0] for node in layers if node.input[1].startswith("head.output")]
    makers = {output: node for node in model.graph.node for output in node.output}
    needed: set[str] = set()
    open_ends = list(outputs)
    while open_ends:
        name = open_ends.pop()
        if name and name != first and name not in needed:
            needed.add(name)
            open_ends.extend(makers[name].input if name in makers else ())
    part = onnx.helper.make_graph(
        [node for node in model.graph.node if needed & set(node.output)],
        "convolutions",
        [onnx.helper.make_tensor_value_info(first, onnx.TensorProto.FLOAT, ["N", 3, "H", "W"])],
        [onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, None) for name in outputs],
        [tensor for tensor in model.graph.initializer if tensor.name in needed],
    )
    whole = onnx.helper.make_model(part, opset_imports=model.opset_import, ir_version=model.ir_version)
    return whole.SerializeToString(), first


def session(file: bytes, threads: int) -> Any:
    """As the service opens its models."""
    runtime = extras.onnxruntime()
    options = runtime.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 4
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    return runtime.InferenceSession(file, options, providers=["CPUExecutionProvider"])


def detect_ways(cores: int, pool: Executor) -> dict[str, tuple[Work, int]]:
    """Work by name, and how many images it is for."""
    file, name = convolutions(DEFAULT_PATH)
    images = np.random.default_rng(0).random((max(BATCHES), 3, *_SIDES), dtype=np.float32)
    wide = session(file, cores)
    narrow = [session(file, 1) for _ in range(cores)]

    def row(images_in_row: int) -> None:
        for index in range(images_in_row):
            wide.run(None, {name: images[index : index + 1]})

    def batch(size: int) -> None:
        wide.run(None, {name: images[:size]})

    def beside() -> None:
        calls = [pool.submit(one.run, None, {name: images[:1]}) for one in narrow]
        for call in calls:
            call.result()

    ways: dict[str, tuple[Work, int]] = {
        f"{cores} threads, {size} in a row": (partial(row, size), size) for size in BATCHES
    }
    ways |= {f"{cores} threads, batch of {size}": (partial(batch, size), size) for size in BATCHES[1:]}
    return {**ways, f"{cores} at a time, 1 thread each": (beside, cores)}


_labeller: Labeller
_frames: list[Frame]


def _open_labeller(given: list[Frame], threads: int) -> None:
    """In a process of a pool."""
    global _labeller, _frames
    torch.set_num_threads(threads)
    _labeller, _frames = Labeller(), given
    _labeller.label(given[0])


def _label(index: int) -> None:
    _labeller.label(_frames[index])


def label_ways(cores: int, pools: ExitStack) -> Iterator[tuple[str, tuple[Work, int]]]:
    """Work by name, and how many frames it is for."""
    chosen = frames(None, _FRAMES)
    context = multiprocessing.get_context("spawn")
    for processes, threads in ((1, 1), (1, cores), (2, 1), (4, 1)):
        pool = pools.enter_context(ProcessPoolExecutor(processes, context, _open_labeller, (chosen, threads)))

        def work(pool: ProcessPoolExecutor = pool) -> None:
            list(pool.map(_label, range(_FRAMES)))

        yield f"{processes} processes, {threads} threads", (work, _FRAMES)


def stages_by_objects(repeats: int) -> dict[str, dict[str, float]]:
    """Median milliseconds of each stage of a frame, by its number of objects."""
    seed = next(seed for seed in count() if len(generate(seed).frame.prompts) >= 2 * OBJECTS)
    whole = generate(seed).frame
    chosen = {
        objects: replace(whole, prompts=whole.prompts[:objects], instance_ids=None)
        for objects in (OBJECTS, 2 * OBJECTS)
    }
    torch.set_num_threads(1)
    labeller = Labeller()
    seconds: dict[int, dict[str, list[float]]] = {objects: defaultdict(list) for objects in chosen}
    for repeat in range(repeats + 1):
        for objects, frame in chosen.items():
            times = StageTimes()
            labeller.label(frame, times)
            for stage, took in times.seconds.items():
                if repeat:
                    seconds[objects][stage].append(took)
    return {
        stage: {f"{objects} objects": 1000 * statistics.median(seconds[objects][stage]) for objects in chosen}
        for stage in seconds[OBJECTS]
    }


def measure(ways: dict[str, tuple[Work, int]], repeats: int) -> dict[str, float]:
    """Median milliseconds per image or frame, by name."""
    seconds: dict[str, list[float]] = defaultdict(list)
    for repeat in range(repeats + 1):
        for name, (work, images) in ways.items():
            start = time.perf_counter()
            work()
            if repeat:  # the first round warms up
                seconds[name].append((time.perf_counter() - start) / images)
    return {name: 1000 * statistics.median(values) for name, values in seconds.items()}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    cores = os.cpu_count() or 1
    told: dict[str, Any] = circumstances({})
    print_circumstances(told)
    with ThreadPoolExecutor(cores) as pool:
        told["detect"] = measure(detect_ways(cores, pool), arguments.repeats)
    with ExitStack() as pools:
        told["label"] = measure(dict(label_ways(cores, pools)), arguments.repeats)
    told["label_stages"] = stages_by_objects(arguments.repeats)
    for route in ("detect", "label"):
        best = min(told[route].values())
        for name, milliseconds in told[route].items():
            print(f"/{route:8}{name:32}{milliseconds:8.1f}{milliseconds / best:8.2f}")
    for stage, by_objects in told["label_stages"].items():
        few, many = by_objects.values()
        print(f"/label, stage {stage:14}{few:8.1f} of {OBJECTS} objects{many:8.1f} of {2 * OBJECTS}")
    write_json(arguments.json, told)


if __name__ == "__main__":
    main()
