"""The trained head with NanoDet as the ONNX files of a monocular model: full precision, and a smaller one."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from boxlift.detector import DEFAULT_FILE
from boxlift.network import onnx_files
from boxlift.network.detections import CLASSES
from boxlift.network.geometry import typical_sizes
from boxlift.network.graphs import MONOCULAR_INPUTS, MONOCULAR_OUTPUTS, MonocularGraph
from boxlift.network.lifter import Lifter
from boxlift.network.nanodet import NanoDetHead, NanoDetTrunk

# KITTI's, where most of what a model may be trained on comes from; other cameras are resized to it.
FOCAL_PX = 721.5
_MIN_SCORE = 0.2
# The property that holds the arguments of Lifter.
_LIFTER = "lifter"
_EXAMPLE_SIZE = (375, 1242)


def monocular_graph(lifter: Lifter) -> MonocularGraph:
    """The whole network with the weights of the detector that comes with boxlift.

    The head's weights are rounded to 16-bit floats, as they will be stored: three digits are enough for them.
    """
    for weight in lifter.parameters():
        weight.data = weight.data.half().float()
    weights = onnx_files.read_weights(DEFAULT_FILE)
    trunk, head = NanoDetTrunk(), NanoDetHead(_class_count(weights))
    onnx_files.load_weights(trunk, weights, "trunk.trunk.")
    onnx_files.load_weights(head, weights, "head.")
    return MonocularGraph(trunk, head, lifter, _MIN_SCORE).eval()


def read_lifter(path: Path) -> Lifter:
    """The head in a file that export_monocular wrote, to go on from or to compare with."""
    lifter = Lifter(**json.loads(onnx_files.read_metadata(path)[_LIFTER]))
    onnx_files.load_weights(lifter, onnx_files.read_weights(path), "lifter.")
    return lifter.eval()


def export_monocular(
    graph: MonocularGraph, path: Path, small_path: Path | None, about: Mapping[str, Any]
) -> None:
    """Write the model, and a smaller one whose weights are 8-bit integers.

    about: properties such as name, training_data and licence; classes, sizes and the rest are added.
    """
    height, width = _EXAMPLE_SIZE
    example = [
        torch.zeros((height, width, 3), dtype=torch.uint8),
        torch.tensor([[FOCAL_PX, 0, width / 2, 0], [0, FOCAL_PX, height / 2, 0], [0, 0, 1, 0]]),
        torch.tensor([[100.0, 100, 200, 200], [300, 150, 350, 200]]),
        torch.tensor([0, 0]),
    ]
    dynamic = [{0: "height", 1: "width"}, {}, {0: "prompts"}, {0: "prompts"}]
    model = onnx_files.export(graph, example, MONOCULAR_INPUTS, MONOCULAR_OUTPUTS, dynamic)
    sizes = typical_sizes().tolist()
    properties = {
        **about,
        "boxlift_interface": "monocular/1",
        "classes": CLASSES,
        "sizes_m": {
            name: [round(side, 4) for side in size] for name, size in zip(CLASSES, sizes, strict=True)
        },
        "focal_px": str(FOCAL_PX),
        "heading_period": "pi",
        _LIFTER: graph.lifter.shape,
    }
    if small_path is not None:
        small = type(model)()
        small.CopyFrom(model)
        onnx_files.store_as_int8(small)
        onnx_files.store_small(small)
        onnx_files.write(small, small_path, {**properties, "precision": "int8 weights"})
    onnx_files.store_small(model)
    onnx_files.write(model, path, {**properties, "precision": "float32"})


def _class_count(weights: Mapping[str, Any]) -> int:
    """The classes of a detector's head, which also has 4 x 11 outputs for the sides of a box."""
    return int(weights["head.output.0.bias"].shape[0]) - 44
