"""Small ONNX files for tests: real graphs, built here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import onnx
from onnx import TensorProto, helper

Shape = Sequence[int | str]


def value(name: str, element_type: int, shape: Shape) -> Any:
    """An input or output; letters are sides of any length."""
    return helper.make_tensor_value_info(name, element_type, shape)


def constant(name: str, element_type: int, shape: Sequence[int], values: Sequence[float]) -> Any:
    """A node whose output `name` is always the same."""
    tensor = helper.make_tensor(name, element_type, shape, values)
    return helper.make_node("Constant", [], [name], value=tensor)


def save(
    path: Path,
    nodes: Sequence[Any],
    inputs: Sequence[Any],
    outputs: Sequence[Any],
    metadata: Mapping[str, str] | None = None,
) -> Path:
    """Write a model of opset 17 that ONNX's own checker accepts."""
    graph = helper.make_graph(nodes, "test", inputs, outputs)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    helper.set_model_props(model, dict(metadata or {}))
    onnx.checker.check_model(model, full_check=True)
    onnx.save(model, path)
    return path


IMAGE = value("image", TensorProto.UINT8, ("H", "W", 3))
