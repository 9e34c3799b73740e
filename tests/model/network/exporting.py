"""Export of a module to ONNX Runtime, for tests of parity."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

OPSET = 18


def export(
    module: nn.Module, inputs: tuple[Tensor, ...], dynamic: tuple[dict[int, Any], ...], path: Path
) -> None:
    """Write the module as an ONNX file; `dynamic` names the axes of each input whose size is free."""
    with warnings.catch_warnings():
        # torch's own deprecations inside the exporter.
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            module.eval(),
            inputs,
            dynamo=True,
            opset_version=OPSET,
            dynamic_shapes=dynamic,
            verbose=False,
        )
    assert program is not None
    program.save(path)


def run(path: Path, *inputs: Tensor) -> list[NDArray[np.float32]]:
    """The outputs of an ONNX file, on one thread."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    names = [entry.name for entry in session.get_inputs()]
    outputs = session.run(None, {name: value.numpy() for name, value in zip(names, inputs, strict=True)})
    return [np.asarray(output) for output in outputs]
