from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from boxlift import InputError
from boxlift.errors import ModelFileError
from boxlift.onnx_model import Interface, OnnxModel, Tensor
from model.onnx_files import IMAGE, constant, save, value

# One row of means per image row, and one number for all of it.
MEANS = Interface(
    inputs=(Tensor("image", "uint8", ("H", "W", 3)),),
    outputs=(
        Tensor("rows", "float32", ("H", 3)),
        Tensor("channels", ("float32", "float64"), (3,)),
        Tensor("extra", "int64", ("N",), optional=True),
    ),
    metadata={"classes": None, "kind": "means/1"},
    remedy="Export it again.",
)
METADATA = {"classes": '["Car", "Van"]', "kind": "means/1"}


def means_file(path: Path, metadata: dict[str, str] | None = None) -> Path:
    nodes = [
        helper.make_node("Cast", ["image"], ["x"], to=TensorProto.FLOAT),
        helper.make_node("ReduceMean", ["x"], ["rows"], axes=[1], keepdims=0),
        helper.make_node("ReduceMean", ["x"], ["channels"], axes=[0, 1], keepdims=0),
    ]
    outputs = [value("rows", TensorProto.FLOAT, ("H", 3)), value("channels", TensorProto.FLOAT, (3,))]
    return save(path, nodes, [IMAGE], outputs, METADATA if metadata is None else metadata)


@pytest.fixture(scope="module")
def means(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return means_file(tmp_path_factory.mktemp("models") / "means.onnx")


@pytest.mark.parametrize("threads", [1, 2])
def test_it_runs_on_any_size(means: Path, threads: int) -> None:
    model = OnnxModel.open(means, MEANS, threads)
    assert model.output_names == ("rows", "channels")
    for height, width in ((4, 7), (1, 1), (375, 1242)):
        image = np.random.default_rng(height).integers(0, 256, (height, width, 3), np.uint8)
        answer = model.run({"image": image})
        np.testing.assert_allclose(answer["rows"], image.mean(1), rtol=1e-5)
        np.testing.assert_allclose(answer["channels"], image.mean((0, 1)), rtol=1e-5)
    assert model.run({"image": np.zeros((0, 4, 3), np.uint8)})["rows"].shape == (0, 3)


def test_digest_metadata_and_classes(means: Path, tmp_path: Path) -> None:
    model = OnnxModel.open(str(means), MEANS)
    assert model.digest == hashlib.sha256(means.read_bytes()).hexdigest()
    assert model.metadata == METADATA
    assert model.class_names() == ("Car", "Van")
    # Weights that torch's exporter keeps in a file beside are part of the model.
    (tmp_path / "m.onnx").write_bytes(means.read_bytes())
    (tmp_path / "m.onnx.data").write_bytes(b"weights")
    beside = OnnxModel.open(tmp_path / "m.onnx", MEANS)
    assert beside.digest == hashlib.sha256(means.read_bytes() + b"weights").hexdigest()


@pytest.mark.parametrize(
    "classes", ["", "Car", "[]", "[1]", '[""]', '["a\\nb"]', '{"Car": 1}', "[" * 100_000]
)
def test_classes_that_are_none(tmp_path: Path, classes: str) -> None:
    path = means_file(tmp_path / "m.onnx", METADATA | {"classes": classes})
    with pytest.raises(ModelFileError, match="its property 'classes' is no JSON list of class names"):
        OnnxModel.open(path, MEANS).class_names()


def _foreign(path: Path, kind: str) -> None:
    """Write something to `path` that is no model with the interface MEANS."""
    image, rows, channels = (
        IMAGE,
        value("rows", TensorProto.FLOAT, ("H", 3)),
        value("channels", TensorProto.FLOAT, (3,)),
    )
    nodes = [
        helper.make_node("Cast", ["image"], ["x"], to=TensorProto.FLOAT),
        helper.make_node("ReduceMean", ["x"], ["rows"], axes=[1], keepdims=0),
        helper.make_node("ReduceMean", ["x"], ["channels"], axes=[0, 1], keepdims=0),
    ]
    metadata = METADATA
    match kind:
        case "no file":
            return
        case "directory":
            path.mkdir()
            return
        case "pipe":
            os.mkfifo(path)
            return
        case "empty":
            path.write_bytes(b"")
            return
        case "text":
            path.write_text("# no model\n" * 100)
            return
        case "huge":
            with path.open("wb") as file:
                file.truncate(2**31)
            return
        case "zeros":
            path.write_bytes(bytes(10_000))
            return
        case "truncated":
            whole = means_file(path).read_bytes()
            path.write_bytes(whole[: len(whole) // 2])
            return
        case "unknown operator":
            nodes[1] = helper.make_node("ReduceMeen", ["x"], ["rows"])
        case "no image":
            image = value("picture", TensorProto.UINT8, ("H", "W", 3))
            nodes[0] = helper.make_node("Cast", ["picture"], ["x"], to=TensorProto.FLOAT)
        case "float image":
            image = value("image", TensorProto.FLOAT, ("H", "W", 3))
        case "fixed size":
            image = value("image", TensorProto.UINT8, (320, 320, 3))
            rows = value("rows", TensorProto.FLOAT, (320, 3))
        case "a batch":
            image = value("image", TensorProto.UINT8, ("B", "H", "W", 3))
            nodes[1] = helper.make_node("ReduceMean", ["x"], ["rows"], axes=[0, 2], keepdims=0)
            nodes[2] = helper.make_node("ReduceMean", ["x"], ["channels"], axes=[0, 1, 2], keepdims=0)
        case "one input more":
            inputs = [image, value("threshold", TensorProto.FLOAT, ())]
            save(path, nodes, inputs, [rows, channels], metadata)
            return
        case "no rows":
            del nodes[1]
            save(path, nodes, [image], [channels], metadata)
            return
        case "wrong type":
            nodes[2] = helper.make_node("ReduceMean", ["x"], ["mean"], axes=[0, 1], keepdims=0)
            nodes.append(helper.make_node("Cast", ["mean"], ["channels"], to=TensorProto.INT64))
            channels = value("channels", TensorProto.INT64, (3,))
        case "no metadata":
            metadata = {}
        case "another kind":
            metadata = METADATA | {"kind": "means/2"}
    if kind == "unknown operator":  # ONNX's own checker would refuse it
        graph = helper.make_graph(nodes, "test", [image], [rows, channels])
        onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9), path)
    else:
        save(path, nodes, [image], [rows, channels], metadata)


@pytest.mark.parametrize(
    ("kind", "problem"),
    [
        ("no file", "the path does not exist. Give the path of an ONNX model."),
        ("directory", "the path is a directory."),
        ("pipe", "the path is no file."),
        ("empty", "the file is empty."),
        ("text", "ONNX Runtime cannot load it ("),
        ("huge", "the file has 2147483648 bytes, too many for an ONNX model."),
        ("zeros", "ONNX Runtime cannot load it ("),
        ("truncated", "ONNX Runtime cannot load it ("),
        ("unknown operator", "ONNX Runtime cannot load it ("),
        ("no image", "the model has no input 'image' (picture -> rows, channels). Export it again."),
        ("float image", "its input 'image' is float32, uint8 (H, W, 3) is needed."),
        (
            "fixed size",
            "its input 'image' has the shape (320, 320, 3), (H, W, 3) with letters for any length",
        ),
        ("a batch", "its input 'image' has the shape (B, H, W, 3), (H, W, 3)"),
        ("one input more", "the model wants an input 'threshold' that nobody gives it."),
        ("no rows", "the model has no output 'rows' (image -> channels)."),
        ("wrong type", "its output 'channels' is int64, float32 or float64 (3) is needed."),
        ("no metadata", "the model has no metadata property 'classes'."),
        ("another kind", "its property 'kind' is 'means/2', not 'means/1'."),
    ],
)
def test_a_file_that_is_no_such_model(
    tmp_path: Path, kind: str, problem: str, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "m.onnx"
    _foreign(path, kind)
    with pytest.raises(ModelFileError) as caught:
        OnnxModel.open(path, MEANS)
    assert str(caught.value).startswith(f"{path}: {problem}")
    assert isinstance(caught.value, InputError)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")  # ONNX Runtime logs nothing beside


def test_damaged_files_are_errors_or_models(
    means: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    whole = means.read_bytes()
    rng = np.random.default_rng(0)
    path = tmp_path / "m.onnx"
    refused = 0
    for trial in range(400):
        damaged = bytearray(whole)
        for position in rng.integers(0, len(whole), rng.integers(1, 6)):
            damaged[position] = rng.integers(256)
        path.write_bytes(damaged if trial % 2 else damaged[: rng.integers(1, len(whole))])
        try:
            OnnxModel.open(path, MEANS).run({"image": np.zeros((2, 2, 3), np.uint8)})
        except ModelFileError:
            refused += 1
    assert refused > 200
    assert capfd.readouterr() == ("", "")


def test_a_model_that_fails_or_answers_something_else(tmp_path: Path) -> None:
    # Names a length of its own, and gives twice as many rows.
    nodes = [
        helper.make_node("Cast", ["image"], ["x"], to=TensorProto.FLOAT),
        helper.make_node("ReduceMean", ["x"], ["mean"], axes=[1], keepdims=0),
        helper.make_node("Concat", ["mean", "mean"], ["rows"], axis=0),
        constant("channels", TensorProto.FLOAT, [3], [0, 0, 0]),
    ]
    outputs = [value("rows", TensorProto.FLOAT, ("M", 3)), value("channels", TensorProto.FLOAT, (3,))]
    longer = OnnxModel.open(save(tmp_path / "a.onnx", nodes, [IMAGE], outputs, METADATA), MEANS)
    with pytest.raises(ModelFileError) as caught:
        longer.run({"image": np.zeros((5, 4, 3), np.uint8)})
    assert caught.value.problem == (
        "its output 'rows' is float32 (10, 3), float32 (H, 3) with H = 5 is needed."
    )
    # Works for images that are 8 pixels high only.
    nodes[2] = helper.make_node("Add", ["mean", "eight"], ["rows"])
    nodes.insert(2, constant("eight", TensorProto.FLOAT, [8, 3], [0.0] * 24))
    picky = OnnxModel.open(save(tmp_path / "b.onnx", nodes, [IMAGE], outputs, METADATA), MEANS)
    assert picky.run({"image": np.zeros((8, 4, 3), np.uint8)})["rows"].shape == (8, 3)
    with pytest.raises(ModelFileError, match=r"the model fails on image \(5, 4, 3\) \("):
        picky.run({"image": np.zeros((5, 4, 3), np.uint8)})


def test_wrong_calls_are_value_errors(means: Path) -> None:
    with pytest.raises(ValueError, match="threads is 0"):
        OnnxModel.open(means, MEANS, threads=0)
    with pytest.raises(ValueError, match="input 'image' is float64"):
        OnnxModel.open(means, MEANS).run({"image": np.zeros((2, 2, 3))})


def test_threads_wait_asleep_and_a_missing_runtime_names_its_extra(means: Path) -> None:
    # In a process of its own: with 2 threads, an idle session takes no time of the cores.
    code = f"""
import time
from model.test_onnx_model import MEANS
from boxlift.onnx_model import OnnxModel
import numpy as np
model = OnnxModel.open({str(means)!r}, MEANS, threads=2)
image = np.zeros((375, 1242, 3), np.uint8)
model.run({{"image": image}})
before = time.process_time()
time.sleep(0.5)
print(time.process_time() - before)
"""
    tests = str(Path(__file__).parents[1])
    ran = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"PYTHONPATH": tests},
    )
    assert float(ran.stdout) < 0.1
    code = """
import sys
sys.modules["onnxruntime"] = None
from pathlib import Path
import boxlift.errors, boxlift.onnx_model
try:
    boxlift.onnx_model.OnnxModel.open(Path("m.onnx"), boxlift.onnx_model.Interface((), (), ""))
except boxlift.errors.MissingExtraError as error:
    print(error)
"""
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "onnxruntime is not installed; install it with: pip install 'boxlift[detect]'." in ran.stdout
