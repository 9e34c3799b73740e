from __future__ import annotations

import copy
import sys
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch
from numpy.typing import NDArray
from onnx import numpy_helper
from torch import Tensor, nn

from boxlift.extras import onnxruntime
from boxlift.network import onnx_files

INPUTS, OUTPUTS = ("image", "features"), ("first", "second")
DYNAMIC = ({2: "height", 3: "width"}, {0: "rows"})


class Network(nn.Module):
    """A convolution, matrix products stored both ways round, and weights too few to be stored smaller."""

    def __init__(self) -> None:
        super().__init__()
        self.conv = nn.Conv2d(3, 16, 3, padding=1)
        self.linear = nn.Linear(32, 24)
        self.product = nn.Parameter(torch.randn(24, 20))
        self.few = nn.Linear(20, 3)

    def forward(self, image: Tensor, features: Tensor) -> tuple[Tensor, Tensor]:
        return self.conv(image).relu(), self.few((self.linear(features).relu() @ self.product).relu())


@pytest.fixture(scope="module")
def network() -> Network:
    torch.set_num_threads(1)
    torch.manual_seed(0)
    network = Network().eval()
    with torch.no_grad():
        # These 16-bit floats hold; of `linear` and `product` they do not.
        network.conv.weight.copy_(network.conv.weight.half())
    return network


@pytest.fixture(scope="module")
def exported(network: Network) -> Any:
    return onnx_files.export(network, _example(), INPUTS, OUTPUTS, DYNAMIC)


@pytest.fixture
def model(exported: Any) -> Any:
    """A copy to be changed."""
    return copy.deepcopy(exported)


def _example(height: int = 20, width: int = 30, rows: int = 4) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(height)
    return (
        torch.rand(1, 3, height, width, generator=generator),
        torch.randn(rows, 32, generator=generator),
    )


def _run(model: Any, *inputs: Tensor) -> list[NDArray[np.float32]]:
    runtime = onnxruntime()
    options = runtime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = runtime.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])
    named = {name: values.numpy() for name, values in zip(INPUTS, inputs, strict=True)}
    answers: list[NDArray[np.float32]] = session.run(list(OUTPUTS), named)
    return answers


def _stored(model: Any) -> dict[str, NDArray[Any]]:
    return {each.name: numpy_helper.to_array(each) for each in model.graph.initializer}


def test_exported_is_the_network_for_any_size(network: Network, exported: Any) -> None:
    for inputs in (_example(), _example(7, 50, 1), _example(33, 11, 9)):
        with torch.no_grad():
            expected = network(*inputs)
        for found, values in zip(_run(exported, *inputs), expected, strict=True):
            np.testing.assert_allclose(found, values, atol=1e-5)
    shapes = {
        value.name: [dim.dim_param or dim.dim_value for dim in value.type.tensor_type.shape.dim]
        for value in exported.graph.input
    }
    assert shapes == {"image": [1, 3, "height", "width"], "features": ["rows", 32]}


def test_store_small_is_exact_and_smaller(exported: Any, model: Any) -> None:
    onnx_files.store_small(model)
    stored = _stored(model)
    assert stored["conv.weight.stored"].dtype == np.float16
    assert "conv.weight" not in stored
    # Not exact, or few: as they are.
    assert stored["linear.weight"].dtype == stored["few.weight"].dtype == np.float32
    assert model.ByteSize() < exported.ByteSize() - 16 * 27 * 2 + 200
    for found, expected in zip(_run(model, *_example()), _run(exported, *_example()), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_store_small_everywhere_where_asked(exported: Any, model: Any) -> None:
    onnx_files.store_small(model, lossy=True)
    stored = _stored(model)
    assert stored["linear.weight.stored"].dtype == np.float16
    for found, expected in zip(_run(model, *_example()), _run(exported, *_example()), strict=True):
        np.testing.assert_allclose(found, expected, atol=0.02)


def test_int8_weights_are_within_half_a_step_of_each_output(network: Network, model: Any) -> None:
    full = _stored(model)
    onnx_files.store_as_int8(model)
    stored = _stored(model)
    quantized = {
        name.removesuffix(".stored"): values for name, values in stored.items() if values.dtype == np.int8
    }
    for name, integers in quantized.items():
        steps = stored[f"{name}.scale"]
        assert np.abs(integers).max() == 127
        assert (np.abs(integers * steps - full[name]) <= steps * 0.5001).all(), name
        # Somewhere in every output the integers are used up.
        assert (np.abs(integers) == 127).sum() >= steps.size
    # One step per output: channels of a convolution, columns of a product.
    assert stored["conv.weight.scale"].shape == (16, 1, 1, 1)
    assert stored["product.scale"].shape == (1, 20)
    # Every product's weights, however torch chose to write it.
    assert sum(values.size for values in quantized.values()) == 16 * 27 + 32 * 24 + 24 * 20
    with torch.no_grad():
        expected = network(*_example())
    for found, values in zip(_run(model, *_example()), expected, strict=True):
        np.testing.assert_allclose(found, values, atol=0.05 * float(values.abs().max()))


def test_outputs_without_weights_are_stored_as_zeros(model: Any) -> None:
    _change(model, "conv.weight", 3, 0.0)
    expected = _run(model, *_example())[0]
    onnx_files.store_as_int8(model)
    found = _run(model, *_example())[0]
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found[:, 3], expected[:, 3], atol=1e-6)


def _change(model: Any, name: str, row: int, value: float) -> None:
    """Set one output's weights."""
    (weight,) = (each for each in model.graph.initializer if each.name == name)
    values = numpy_helper.to_array(weight).copy()
    values[row] = value
    weight.CopyFrom(numpy_helper.from_array(values, name))


def test_written_file_describes_itself(model: Any, tmp_path: Path) -> None:
    path = tmp_path / "new" / "model.onnx"
    onnx_files.write(model, path, {"name": "small", "classes": ["Car", "Truck"], "sizes": {"Car": [4, 2]}})
    described = onnx_files.read_metadata(path)
    assert described["name"] == "small"
    assert described["classes"] == '["Car", "Truck"]'
    assert described["sizes"] == '{"Car": [4, 2]}'
    assert described["opset"] == str(onnx_files.OPSET)
    assert described["created_by"].startswith("boxlift ")
    assert len(bytes.fromhex(described["weights_digest"])) == 32
    written = onnx.load(path)
    onnx.checker.check_model(written, full_check=True)
    assert [each.version for each in written.opset_import if not each.domain] == [onnx_files.OPSET]
    for found, expected in zip(_run(written, *_example()), _run(model, *_example()), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_written_file_names_no_machine(model: Any, tmp_path: Path) -> None:
    """Exporters note where code lies, and who called it."""
    path = tmp_path / "model.onnx"
    onnx_files.write(model, path, {})
    content = path.read_bytes()
    here = Path(__file__).resolve()
    for trace in (str(here.parents[3]), str(Path.home()), sys.prefix, "site-packages", here.name, ".py"):
        assert trace.encode() not in content, trace
    assert b"pytorch" not in content.lower()


@pytest.mark.parametrize("small", [False, True])
def test_weights_are_read_back(network: Network, model: Any, tmp_path: Path, *, small: bool) -> None:
    if small:
        onnx_files.store_small(model)
    onnx_files.write(model, tmp_path / "model.onnx", {})
    weights = onnx_files.read_weights(tmp_path / "model.onnx")
    assert all(values.dtype == np.float32 for values in weights.values())
    prefixed = {f"part.{name}": values for name, values in weights.items()}
    again = Network()
    onnx_files.load_weights(again, prefixed, "part.")
    for name, values in network.state_dict().items():
        assert torch.equal(again.state_dict()[name], values), name
    with pytest.raises(KeyError, match="other"):
        onnx_files.load_weights(again, prefixed, "other.")


def test_digest_is_that_of_the_weights(model: Any, tmp_path: Path) -> None:
    def digest(**about: str) -> str:
        onnx_files.write(model, tmp_path / "model.onnx", about)
        return onnx_files.read_metadata(tmp_path / "model.onnx")["weights_digest"]

    first = digest()
    assert digest(name="another") == first
    _change(model, "few.bias", 1, 0.125)
    changed = digest()
    assert changed != first
    _change(model, "few.bias", 1, np.nextafter(np.float32(0.125), np.float32(1)))
    assert digest() not in (first, changed)
