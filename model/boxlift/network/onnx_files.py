"""ONNX files: how graphs are exported, stored small, described, and read back as weights.

A weight that a 16-bit float holds exactly is stored as one and cast when the file is loaded (ONNX Runtime
does that once, at the start): half the size, the same numbers.
"""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from boxlift.extras import onnx as onnx_module

OPSET = 18
_STORED_SMALLER = 256  # elements; below it a cast costs more than it saves
_SUFFIX = ".stored"


def export(
    graph: nn.Module,
    example: Sequence[Tensor],
    inputs: Sequence[str],
    outputs: Sequence[str],
    dynamic: Sequence[Mapping[int, str]],
) -> Any:
    """A module as an ONNX model (an onnx.ModelProto), weights under the module's own names.

    dynamic: for each input the axes that may have any length, with a name for each.
    """
    any_length = tuple(dict.fromkeys(axes, torch.export.Dim.DYNAMIC) for axes in dynamic)
    with warnings.catch_warnings(), torch.no_grad():
        # Deprecations between torch's own parts.
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            graph.eval(),
            tuple(example),
            dynamo=True,
            opset_version=OPSET,
            input_names=list(inputs),
            output_names=list(outputs),
            dynamic_shapes=any_length,
            verbose=False,
        )
    assert program is not None
    model = program.model_proto
    names = {
        old: new
        for value, axes in zip(model.graph.input, dynamic, strict=True)
        for old, new in _renamed(value, axes)
    }
    for value in (*model.graph.input, *model.graph.output, *model.graph.value_info):
        for dim in value.type.tensor_type.shape.dim:
            if dim.dim_param in names:
                dim.dim_param = names[dim.dim_param]
    return model


def _renamed(value: Any, axes: Mapping[int, str]) -> list[tuple[str, str]]:
    dims = value.type.tensor_type.shape.dim
    return [(dims[axis].dim_param, name) for axis, name in axes.items()]


def store_small(model: Any, *, lossy: bool = False) -> None:
    """Store weights as 16-bit floats where that is exact (or, `lossy`, everywhere); changes `model`."""
    onnx = onnx_module()
    for weight in list(model.graph.initializer):
        if weight.data_type != onnx.TensorProto.FLOAT:
            continue
        values = onnx.numpy_helper.to_array(weight)
        halved = values.astype(np.float16)
        if values.size < _STORED_SMALLER or not (lossy or np.array_equal(halved.astype(np.float32), values)):
            continue
        stored = onnx.numpy_helper.from_array(halved, weight.name + _SUFFIX)
        cast = onnx.helper.make_node("Cast", [stored.name], [weight.name], to=onnx.TensorProto.FLOAT)
        _replace(model, weight, [stored], cast)


def store_as_int8(model: Any) -> None:
    """Store the weights of convolutions and matrix products as int8 with a scale per output; changes `model`.

    Symmetric, by the largest weight of each output. Only what is stored shrinks: the arithmetic stays
    float, so that results do not depend on a processor's integer instructions.
    """
    onnx = onnx_module()
    output_axis = {
        node.input[1]: 0 if node.op_type == "Conv" else 1
        for node in model.graph.node
        if node.op_type in ("Conv", "MatMul")
    }
    output_axis |= {
        node.input[1]: 0 if any(a.name == "transB" and a.i for a in node.attribute) else 1
        for node in model.graph.node
        if node.op_type == "Gemm"
    }
    for weight in list(model.graph.initializer):
        if weight.name not in output_axis or len(weight.dims) < 2:
            continue
        values = onnx.numpy_helper.to_array(weight)
        if values.size < _STORED_SMALLER:
            continue
        axis = output_axis[weight.name]
        others = tuple(i for i in range(values.ndim) if i != axis)
        scale = np.maximum(np.abs(values).max(others) / 127, 1e-12).astype(np.float32)
        shaped = scale.reshape([-1 if i == axis else 1 for i in range(values.ndim)])
        stored = onnx.numpy_helper.from_array(np.rint(values / shaped).astype(np.int8), weight.name + _SUFFIX)
        scales = onnx.numpy_helper.from_array(shaped, weight.name + ".scale")
        # Not DequantizeLinear: ONNX Runtime keeps that and multiplies in every run, where it folds these two.
        whole = onnx.helper.make_node(
            "Cast", [stored.name], [weight.name + ".whole"], to=onnx.TensorProto.FLOAT
        )
        node = onnx.helper.make_node("Mul", [weight.name + ".whole", scales.name], [weight.name])
        _replace(model, weight, [stored, scales], whole, node)


def _replace(model: Any, weight: Any, stored: list[Any], *nodes: Any) -> None:
    model.graph.initializer.remove(weight)
    model.graph.initializer.extend(stored)
    for node in reversed(nodes):
        model.graph.node.insert(0, node)


def write(model: Any, path: Path, metadata: Mapping[str, str | Mapping[str, Any] | Sequence[Any]]) -> None:
    """Write a model with its metadata; what is no string becomes JSON.

    Added are `weights_digest` (sha256 over the names and bytes of all weights), `opset` and `created_by`.
    """
    from boxlift import __version__

    onnx = onnx_module()
    digest = hashlib.sha256()
    for weight in sorted(model.graph.initializer, key=lambda weight: weight.name):
        digest.update(weight.name.encode() + onnx.numpy_helper.to_array(weight).tobytes())
    described = {
        key: value if isinstance(value, str) else json.dumps(value) for key, value in metadata.items()
    }
    described |= {
        "weights_digest": digest.hexdigest(),
        "opset": str(OPSET),
        "created_by": f"boxlift {__version__}",
    }
    del model.metadata_props[:]
    onnx.helper.set_model_props(model, described)
    for node in model.graph.node:
        # Where in our code a node came from is of no use to a user, and names paths of this machine.
        del node.metadata_props[:]
        node.doc_string = ""
    for value in (*model.graph.initializer, *model.graph.input, *model.graph.output):
        del value.metadata_props[:]
    # Shapes in between: ONNX Runtime finds them by itself.
    del model.graph.value_info[:]
    del model.graph.metadata_props[:]
    model.producer_name, model.producer_version, model.doc_string = "boxlift", __version__, ""
    onnx.checker.check_model(model, full_check=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(model.SerializeToString())


def read_weights(path: Path) -> dict[str, NDArray[np.float32]]:
    """The weights of a file that `write` wrote, as floats under their own names."""
    onnx = onnx_module()
    found = {w.name: onnx.numpy_helper.to_array(w) for w in onnx.load(path).graph.initializer}
    weights = {}
    for name, values in found.items():
        if name.endswith(".scale") or values.dtype.kind not in "fi":
            continue
        if values.dtype == np.int8:
            continue  # of the small variant: nobody trains on from that
        weights[name.removesuffix(_SUFFIX)] = values.astype(np.float32)
    return weights


def load_weights(module: nn.Module, weights: Mapping[str, NDArray[np.float32]], prefix: str) -> None:
    """Fill a module with the weights that a file has under `prefix`. Raises KeyError where one is missing."""
    state = {name: torch.from_numpy(weights[f"{prefix}{name}"].copy()) for name in module.state_dict()}
    module.load_state_dict(state)


def read_metadata(path: Path) -> dict[str, str]:
    """The properties of a file that `write` wrote."""
    return {each.key: each.value for each in onnx_module().load(path).metadata_props}
