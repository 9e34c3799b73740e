"""Forward time of each backbone with its RoI heads, in torch and ONNX Runtime, and a few steps of training.

    python benchmarks/backbones.py [--size 1248 384] [--boxes 10] [--runs 20] [--threads 1] [--steps 3]

One image of WIDTH x HEIGHT pixels, the paper's fully connected heads on N boxes. Printed are medians over the
runs, after three warm-up runs, in ms: backbone alone, and backbone with RoI features and heads. The paper
measured 5.9, 8.8 and 12.0 ms for ResNet-18, -34 and -50 on a Titan V.

Then each backbone takes --steps steps of Adam with the paper's losses on one batch of two generated frames:
that it trains, and how long a step takes. torch and ONNX Runtime run one after the other in processes of
their own: in one process their threads get in each other's way.
"""

from __future__ import annotations

import argparse
import multiprocessing
import platform
import statistics
import subprocess
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import get_args

import numpy as np
import torch
from torch import Tensor, nn

from boxlift.datasets.generated import generate
from boxlift.datasets.generated.write import write_dataset
from boxlift.extras import onnxruntime
from boxlift.network import onnx_files
from boxlift.network.backbones import BackboneName
from boxlift.network.config import MonocularSettings
from boxlift.network.monocular_task import MonocularTask
from boxlift.network.paper_head import PaperNetwork

_WARM_UP = 3
_PAPER_MS = {"resnet18": 5.90, "resnet34": 8.77, "resnet50": 11.97}


class Lifted(nn.Module):
    """Backbone, RoI features and heads: image, projection, boxes and their frozen sizes -> parameters."""

    def __init__(self, network: PaperNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, image: Tensor, P: Tensor, boxes_px: Tensor, sizes_m: Tensor) -> tuple[Tensor, ...]:
        return tuple(self.network(image, P, [boxes_px], [sizes_m]))


def settings_of(name: str) -> MonocularSettings:
    """The paper's, on a backbone; NanoDet's features come from both its maps."""
    strides = (8, 16) if name == "nanodet" else (16,)
    return MonocularSettings.model_validate({"model": {"backbone": name, "roi_strides": strides}})


def example(arguments: argparse.Namespace) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """An image of noise and boxes of the size of cars."""
    (width, height), boxes = arguments.size, arguments.boxes
    rng = np.random.default_rng(0)
    middle = rng.uniform((60, 40), (width - 60, height - 40), (boxes, 2))
    half = np.array([40.0, 30.0])
    boxes_px = np.concatenate([middle - half, middle + half], axis=1)
    P = np.array([[[721.5, 0, width / 2, 0], [0, 721.5, height / 2, 0], [0, 0, 1, 0]]])
    return (
        torch.from_numpy(rng.uniform(0, 255, (1, 3, height, width))).float(),
        torch.from_numpy(P).float(),
        torch.from_numpy(boxes_px).float(),
        torch.tensor([[4.0, 1.8, 1.6]]).repeat(boxes, 1),
    )


def median_ms(call: Callable[[], object], runs: int) -> float:
    """Median time of a call."""
    times = []
    for run in range(_WARM_UP + runs):
        start = time.perf_counter()
        call()
        if run >= _WARM_UP:
            times.append((time.perf_counter() - start) * 1e3)
    return statistics.median(times)


def in_torch(name: BackboneName, arguments: argparse.Namespace) -> tuple[float, float, float]:
    """Backbone alone, all, in torch; millions of parameters of the backbone."""
    torch.set_num_threads(arguments.threads)
    network = PaperNetwork(settings_of(name).model).eval()
    inputs = example(arguments)
    with torch.no_grad():
        alone = median_ms(lambda: network.backbone(inputs[0]), arguments.runs)
        together = median_ms(lambda: Lifted(network)(*inputs), arguments.runs)
    parameters = sum(p.numel() for p in network.backbone.parameters()) / 1e6
    return alone, together, parameters


def export(name: BackboneName, arguments: argparse.Namespace, folder: Path) -> tuple[Path, Path]:
    """Backbone alone and all as ONNX files."""
    inputs = example(arguments)
    network = PaperNetwork(settings_of(name).model)
    named = ["image", "P", "boxes_px", "sizes_m"]
    outputs = ["center_px", "depth_m", "orientation", "log_size"]
    paths = folder / f"{name}_alone.onnx", folder / f"{name}.onnx"
    alone = onnx_files.export(network.backbone, inputs[:1], named[:1], ["fine", "coarse"], [{}])
    free = [{}, {}, {0: "boxes"}, {0: "boxes"}]
    together = onnx_files.export(Lifted(network), inputs, named, outputs, free)
    for path, model in zip(paths, (alone, together), strict=True):
        path.write_bytes(model.SerializeToString())
    return paths


def in_onnx_runtime(paths: tuple[Path, Path], arguments: argparse.Namespace) -> tuple[float, float]:
    """Backbone alone, all."""
    runtime = onnxruntime()
    options = runtime.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = arguments.threads, 1
    inputs = [value.numpy() for value in example(arguments)]
    found = []
    for path in paths:
        session = runtime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
        feeds = dict(zip([each.name for each in session.get_inputs()], inputs, strict=False))
        found.append(median_ms(partial(session.run, None, feeds), arguments.runs))
    return found[0], found[1]


def train_a_little(
    name: BackboneName, arguments: argparse.Namespace, folder: Path
) -> tuple[list[float], float]:
    """The loss of each step, and seconds per step, on one batch of two frames."""
    torch.set_num_threads(arguments.threads)
    settings = settings_of(name)
    data = {"train": [{"source": folder / "frames"}]}
    settings = settings.model_copy(update={"data": type(settings.data).model_validate(data)})
    task = MonocularTask(settings, folder)
    torch.manual_seed(0)
    model = task.build(torch.Generator().manual_seed(0)).train()
    optimizer = torch.optim.Adam(model.parameters(), settings.trainer.learning_rate)
    (batch,) = task.batches(0, torch.Generator().manual_seed(0))
    losses, start = [], time.perf_counter()
    for _ in range(arguments.steps):
        loss = torch.stack(list(task.loss(model, batch).values())).sum()
        optimizer.zero_grad()
        torch.autograd.backward(loss)
        optimizer.step()
        losses.append(float(loss.detach()))
    return losses, (time.perf_counter() - start) / arguments.steps


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", type=int, nargs=2, default=(1248, 384), metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--boxes", type=int, default=10)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--steps", type=int, default=3, help="Steps of training; 0: none.")
    arguments = parser.parse_args()
    names: tuple[BackboneName, ...] = get_args(BackboneName)
    print_machine(arguments)
    # A fresh process for every measurement.
    pool = multiprocessing.get_context("spawn").Pool(1, maxtasksperchild=1)
    with TemporaryDirectory() as temporary, pool:
        folder = Path(temporary)
        print("\nms             torch           ONNX Runtime    parameters  paper, Titan V")
        print("               alone    all    alone    all    (backbone)")
        for name in names:
            alone, together, millions = pool.apply(in_torch, (name, arguments))
            paths = pool.apply(export, (name, arguments, folder))
            ort_alone, ort_together = pool.apply(in_onnx_runtime, (paths, arguments))
            paper = f"{_PAPER_MS[name]:10.1f}" if name in _PAPER_MS else ""
            print(
                f"{name:12s} {alone:7.0f} {together:6.0f}  {ort_alone:7.0f} {ort_together:6.0f} "
                f"{millions:8.1f} M {paper}"
            )
        if arguments.steps:
            write_dataset(folder / "frames", [generate(seed) for seed in (3, 5)])
            print(f"\nLoss in {arguments.steps} steps of training on two generated frames, s per step")
            for name in names:
                losses, seconds = pool.apply(train_a_little, (name, arguments, folder))
                print(f"{name:12s} {' '.join(f'{loss:7.3f}' for loss in losses)}   {seconds:5.1f}")


def print_machine(arguments: argparse.Namespace) -> None:
    """Machine, versions and commit."""
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False
    ).stdout.strip()
    cpu = next(
        (line.split(":")[1].strip() for line in _cpu_lines() if line.startswith("model name")),
        platform.processor(),
    )
    print(
        f"{cpu}, {arguments.threads} thread(s); Python {platform.python_version()}, "
        f"torch {torch.__version__}, ONNX Runtime {onnxruntime().__version__}; commit {commit or 'unknown'}"
    )


def _cpu_lines() -> list[str]:
    path = Path("/proc/cpuinfo")
    return path.read_text().splitlines() if path.exists() else []


if __name__ == "__main__":
    main()
