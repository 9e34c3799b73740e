"""Export of a module to ONNX Runtime, for tests of parity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from torch import Tensor, from_numpy, nn
from torch.nn import functional

from boxlift.extras import onnxruntime
from boxlift.network import onnx_files
from boxlift.network.backbones import MULTIPLE


def run_exported(
    module: nn.Module,
    example: Sequence[Tensor],
    dynamic: Sequence[Mapping[int, str]],
    *calls: Sequence[Tensor],
) -> list[list[Tensor]]:
    """The outputs of the exported module on one thread, for every call's inputs.

    dynamic: for each input the axes whose length is free, with a name for each.
    """
    inputs = [f"input_{index}" for index in range(len(example))]
    outputs = _outputs(module, example)
    model = onnx_files.export(module, example, inputs, [f"output_{i}" for i in range(outputs)], dynamic)
    runtime = onnxruntime()
    options = runtime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = runtime.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])
    results = []
    for call in calls:
        found = session.run(None, {name: value.numpy() for name, value in zip(inputs, call, strict=True)})
        results.append([from_numpy(output) for output in found])
    return results


def padded(image: Tensor) -> Tensor:
    """(1, 3, H, W) with black below and right up to the next multiples, as exported graphs do it."""
    height, width = image.shape[2:]
    return functional.pad(image, (0, -width % MULTIPLE, 0, -height % MULTIPLE))


def _outputs(module: nn.Module, example: Sequence[Tensor]) -> int:
    output = module.eval()(*example)
    return 1 if isinstance(output, Tensor) else len(output)
