"""A detector that says what it is told, as a real ONNX file."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from onnx import TensorProto, helper

from model.onnx_files import IMAGE, constant, save, value

Box = tuple[float, float, float, float]


def detector_file(
    path: Path,
    boxes_px: Sequence[Box],
    scores: Sequence[float],
    categories: Sequence[int],
    *,
    classes: Sequence[str] = ("Car", "Pedestrian"),
    masks: NDArray[np.generic] | None = None,
) -> Path:
    """A file with the interface of a detector that finds the same in every image."""
    count = len(boxes_px)
    nodes = [
        constant("boxes_px", TensorProto.FLOAT, [count, 4], [edge for box in boxes_px for edge in box]),
        constant("scores", TensorProto.FLOAT, [len(scores)], scores),
        constant("categories", TensorProto.INT64, [len(categories)], categories),
    ]
    outputs = [
        value("boxes_px", TensorProto.FLOAT, (count, 4)),
        value("scores", TensorProto.FLOAT, (len(scores),)),
        value("categories", TensorProto.INT64, (len(categories),)),
    ]
    if masks is not None:
        kind = helper.np_dtype_to_tensor_dtype(masks.dtype)
        nodes.append(constant("masks", kind, masks.shape, masks.flatten().tolist()))
        outputs.append(value("masks", kind, masks.shape))
    return save(path, nodes, [IMAGE], outputs, {"classes": json.dumps(list(classes))})


def brightness_detector(path: Path, **metadata: str) -> Path:
    """A detector of one Car, with a mask: the pixels whose red is above 128, and the box around them."""
    nodes = [
        constant("zero", TensorProto.INT64, [1], [0]),
        constant("one", TensorProto.INT64, [1], [1]),
        constant("two", TensorProto.INT64, [1], [2]),
        constant("limit", TensorProto.UINT8, [], [128]),
        constant("unit", TensorProto.FLOAT, [], [1.0]),
        helper.make_node("Slice", ["image", "zero", "one", "two"], ["red_1"]),
        helper.make_node("Squeeze", ["red_1", "two"], ["red"]),
        helper.make_node("Greater", ["red", "limit"], ["bright"]),
        helper.make_node("Unsqueeze", ["bright", "zero"], ["masks"]),
        helper.make_node("NonZero", ["bright"], ["places"]),  # (2, K): rows and columns
        helper.make_node("Cast", ["places"], ["places_f"], to=TensorProto.FLOAT),
        helper.make_node("ReduceMin", ["places_f"], ["low_yx"], axes=[1], keepdims=0),
        helper.make_node("ReduceMax", ["places_f"], ["last_yx"], axes=[1], keepdims=0),
        helper.make_node("Add", ["last_yx", "unit"], ["high_yx"]),
        constant("swap", TensorProto.INT64, [2], [1, 0]),
        helper.make_node("Gather", ["low_yx", "swap"], ["low"]),
        helper.make_node("Gather", ["high_yx", "swap"], ["high"]),
        helper.make_node("Concat", ["low", "high"], ["box"], axis=0),
        helper.make_node("Unsqueeze", ["box", "zero"], ["boxes_px"]),
        constant("scores", TensorProto.FLOAT, [1], [0.9]),
        constant("categories", TensorProto.INT64, [1], [0]),
    ]
    outputs = [
        value("boxes_px", TensorProto.FLOAT, (1, 4)),
        value("scores", TensorProto.FLOAT, (1,)),
        value("categories", TensorProto.INT64, (1,)),
        value("masks", TensorProto.BOOL, (1, "H", "W")),
    ]
    return save(path, nodes, [IMAGE], outputs, {"classes": '["Car"]'} | metadata)
