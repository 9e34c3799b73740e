"""The monocular model in this package: what torch says, what it says of itself, how large it is."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import onnx
import pytest
import torch
from numpy.typing import NDArray

from boxlift import Calibration, Prompt
from boxlift.camera import Floats
from boxlift.datasets import load_objects, open_source
from boxlift.datasets.generated import generate
from boxlift.detector import DEFAULT_FILE
from boxlift.formats.calibration import read_calibration
from boxlift.formats.image import decode_image
from boxlift.monocular import DEFAULT_PATH, MONOCULAR, Monocular
from boxlift.network.detections import CLASSES
from boxlift.network.geometry import typical_sizes
from boxlift.network.graphs import MONOCULAR_OUTPUTS, MonocularGraph
from boxlift.network.monocular_export import FOCAL_PX, monocular_graph, read_lifter
from boxlift.network.onnx_files import OPSET, read_metadata
from boxlift.onnx_model import OnnxModel

SMALL_PATH = DEFAULT_PATH.with_name("monocular_small.onnx")
PATHS = [DEFAULT_PATH, SMALL_PATH]
REAL_IMAGES = 20


class Scene(NamedTuple):
    """An image, its camera, and the drawn 2D boxes of the model's classes."""

    name: str
    image: NDArray[np.uint8]
    image_P_cam: Floats
    prompts: tuple[Prompt, ...]

    def inputs(self, *, prompted: bool = True) -> dict[str, Any]:
        """As the interface MONOCULAR names them."""
        prompts = self.prompts if prompted else ()
        boxes_px = np.array([prompt.box_px for prompt in prompts], dtype=np.float32).reshape(-1, 4)
        categories = np.array([CLASSES.index(prompt.category) for prompt in prompts], dtype=np.int64)
        values = (self.image, self.image_P_cam.astype(np.float32), boxes_px, categories)
        return dict(zip((each.name for each in MONOCULAR.inputs), values, strict=True))


@pytest.fixture(scope="module")
def scenes(request: pytest.FixtureRequest) -> Sequence[Scene]:
    """Real images where there are any, else generated ones."""
    torch.set_num_threads(1)
    try:
        return _real(request.getfixturevalue("kitti_object_root"))
    except pytest.skip.Exception:
        return [_generated(seed) for seed in range(4)]


def _real(root: Path) -> list[Scene]:
    source = open_source(root)
    scenes: list[Scene] = []
    for name in source.names:
        labels = [label for label in load_objects("label_2", source, name) if label.category in CLASSES]
        if labels and len(scenes) < REAL_IMAGES:
            image = decode_image(source.root / "image_2" / f"{name}.png")
            P = read_calibration(source.root / "calib" / f"{name}.txt").calibration.image_P_cam
            scenes.append(Scene(name, image, P, tuple(Prompt(each.category, each.box_px) for each in labels)))
    return scenes


def _generated(seed: int) -> Scene:
    generated = generate(seed)
    frame = generated.frame
    assert frame.image is not None
    prompts = tuple(
        Prompt(each.category, each.box_px) for each in generated.truth if each.category in CLASSES
    )
    return Scene(f"generated {seed}", frame.image, frame.calibration.image_P_cam, prompts)


@pytest.fixture(scope="module")
def graph() -> MonocularGraph:
    """The network in torch with the weights in the file."""
    return monocular_graph(read_lifter(DEFAULT_PATH))


@cache
def _model(path: Path) -> OnnxModel:
    return OnnxModel.open(path, MONOCULAR, threads=1)


def _torch_says(graph: MonocularGraph, inputs: dict[str, Any]) -> dict[str, NDArray[Any]]:
    with torch.no_grad():
        outputs = graph(*(torch.from_numpy(values.copy()) for values in inputs.values()))
    return {name: values.numpy() for name, values in zip(MONOCULAR_OUTPUTS, outputs, strict=True)}


def _assert_equal(found: dict[str, Any], expected: dict[str, Any], scene: Scene) -> None:
    assert found.keys() == expected.keys()
    for name, values in expected.items():
        off = found[name] - values
        if name == "rotations_y":
            # Both ends of its range are one heading.
            off = np.sin(off)
        assert np.abs(off).max(initial=0) < 1e-3, (scene.name, name)


def test_file_says_what_torch_says(scenes: Sequence[Scene], graph: MonocularGraph) -> None:
    """Every output, within a millimetre, a thousandth of a pixel, a milliradian."""
    boxes = 0
    for scene in scenes:
        found = _model(DEFAULT_PATH).run(scene.inputs())
        _assert_equal(found, _torch_says(graph, scene.inputs()), scene)
        np.testing.assert_array_equal(found["boxes_px"], scene.inputs()["prompt_boxes_px"])
        assert (found["detection_scores"] == 1).all()
        boxes += len(scene.prompts)
    assert boxes >= 2 * len(scenes)


def test_file_finds_what_torch_finds(scenes: Sequence[Scene], graph: MonocularGraph) -> None:
    """Without prompts, too: the detector in the graph, its suppression and its riders."""
    boxes = 0
    for scene in scenes[:5]:
        inputs = scene.inputs(prompted=False)
        found, expected = _model(DEFAULT_PATH).run(inputs), _torch_says(graph, inputs)
        # Pixels come out of the network here, of which float32 holds 4 digits behind the point.
        for outputs in (found, expected):
            outputs["boxes_px"] = outputs["boxes_px"] / 10
        _assert_equal(found, expected, scene)
        boxes += len(found["scores"])
    assert boxes >= 10


def test_small_variant_says_nearly_the_same(scenes: Sequence[Scene]) -> None:
    depth_off, size_off, angle_off, score_off = [], [], [], []
    for scene in scenes:
        full, small = (_model(path).run(scene.inputs()) for path in PATHS)
        depth_off.append(small["centers_cam"][:, 2] / full["centers_cam"][:, 2] - 1)
        size_off.append(np.abs(small["sizes_m"] / full["sizes_m"] - 1).max(1))
        angle_off.append(np.sin(small["rotations_y"] - full["rotations_y"]))
        score_off.append(small["scores"] - full["scores"])
    for off, most in ((depth_off, 0.01), (size_off, 0.01), (angle_off, 0.05), (score_off, 0.05)):
        assert np.median(np.abs(np.concatenate(off))) < most


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)
def test_it_describes_itself(path: Path) -> None:
    described = read_metadata(path)
    assert described["boxlift_interface"] == "monocular/1"
    assert json.loads(described["classes"]) == list(CLASSES)
    sizes = json.loads(described["sizes_m"])
    np.testing.assert_allclose([sizes[name] for name in CLASSES], typical_sizes(), atol=1e-4)
    assert "KITTI" in described["training_data"]
    assert "CC BY-NC-SA" in described["licence"]
    assert float(described["focal_px"]) == FOCAL_PX
    assert described["opset"] == str(OPSET)
    assert described["created_by"].startswith("boxlift ")
    model = onnx.load(path)
    onnx.checker.check_model(model, full_check=True)
    digest = hashlib.sha256()
    for weight in sorted(model.graph.initializer, key=lambda weight: weight.name):
        digest.update(weight.name.encode() + onnx.numpy_helper.to_array(weight).tobytes())
    assert described["weights_digest"] == digest.hexdigest()
    assert not any(node.metadata_props or node.doc_string for node in model.graph.node)


def test_it_is_small_and_has_its_papers() -> None:
    assert sum(path.stat().st_size for path in (*PATHS, DEFAULT_FILE)) < 20e6
    assert SMALL_PATH.stat().st_size < 0.7 * DEFAULT_PATH.stat().st_size
    beside = {path.name.lower() for path in DEFAULT_PATH.parent.iterdir()}
    assert any(name.startswith("license") for name in beside)
    card = (DEFAULT_PATH.parent / "MODEL_CARD.md").read_text(encoding="utf-8")
    for word in ("KITTI", "NanoDet", "Apache", "CC BY-NC-SA", DEFAULT_PATH.name, SMALL_PATH.name):
        assert word in card, word


def test_wrapper_lifts_prompts(scenes: Sequence[Scene]) -> None:
    """The file through the Python API: cars are about where their height says."""
    model = Monocular.open()
    assert model.classes == CLASSES
    scene = scenes[0]
    lifted = model.detect(scene.name, scene.image, Calibration(scene.image_P_cam, np.eye(4)), scene.prompts)
    assert [label.prompt for label in lifted.objects] == list(scene.prompts)
    depth_m = [label.box.center_cam[0, 2] for label in lifted.objects if label.box is not None]
    assert len(depth_m) == len(scene.prompts)
    assert all(2 < each < 120 for each in depth_m)


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)
@pytest.mark.parametrize("size", [(1, 1), (32, 32), (33, 700), (375, 1242)])
def test_any_size(path: Path, size: tuple[int, int]) -> None:
    """Black images: nothing is found, and what is asked for is answered by finite numbers."""
    P = np.array([[FOCAL_PX, 0, size[1] / 2, 0], [0, FOCAL_PX, size[0] / 2, 0], [0, 0, 1, 0]])
    box_px = (0.0, 0.0, size[1] - 1.0, size[0] - 1.0)
    scene = Scene("black", np.zeros((*size, 3), dtype=np.uint8), P, (Prompt("Car", box_px),))
    prompted = _model(path).run(scene.inputs())
    assert all(len(values) == 1 and np.isfinite(values).all() for values in prompted.values())
    assert all(len(values) == 0 for values in _model(path).run(scene.inputs(prompted=False)).values())
