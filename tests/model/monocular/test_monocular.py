from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from boxlift import Calibration, Prompt
from boxlift.errors import CalibrationError, ImageError, ModelFileError
from boxlift.formats import details, kitti_label
from boxlift.monocular import Monocular
from model.stand_in_model import METADATA, stand_in_model

CAM_SE3_VELO = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
CAR = Prompt("Car", (540.0, 180.0, 660.0, 260.0), 0.5)


def camera(scale: float = 1.0) -> Calibration:
    image_P_cam = np.array([[700.0, 0, 600, 0], [0, 700, 180, 0], [0, 0, 1, 0]])
    image_P_cam[:2] *= scale
    image_P_cam[:2, 2] += (scale - 1) / 2
    return Calibration(image_P_cam, CAM_SE3_VELO)


def grey(width: int = 1200, height: int = 360, value: int = 128) -> NDArray[np.uint8]:
    return np.full((height, width, 3), value, np.uint8)


@pytest.fixture(scope="module")
def model_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return stand_in_model(tmp_path_factory.mktemp("model") / "hand_made.onnx")


@pytest.fixture(scope="module")
def model(model_path: Path) -> Monocular:
    return Monocular.open(model_path)


def test_what_a_model_says_of_itself(model: Monocular) -> None:
    assert model.name == "hand_made"
    assert model.classes == ("Car", "Pedestrian")
    assert len(model.digest) == 64
    assert model.metadata["training_data"] == "none"


def test_a_prompt_is_lifted_and_keeps_its_own_box_and_score(model: Monocular) -> None:
    labels = model.detect("a", grey(), camera(), [CAR])
    (car,) = labels.objects
    assert (car.result.name, car.sentence) == ("PREDICTED", "The model predicted a box.")
    assert car.prompt == CAR
    assert car.box is not None
    np.testing.assert_allclose(car.box.center_cam, [[0, 0.75, 700 * 1.5 / 80]], rtol=1e-6)
    np.testing.assert_allclose([car.box.length_m[0], car.box.width_m[0], car.box.height_m[0]], [4, 1.7, 1.5])
    assert car.score == pytest.approx(0.5 * 128 / 255 / 2)
    assert car.depth_spread == pytest.approx(0.05)
    assert car.flags == ("heading_ambiguous",)
    written = details.details_of(labels).objects[0]
    assert written.depth_spread == 0.05
    assert kitti_label.to_text(kitti_label.objects_of(labels)).startswith("Car -1 -1 0.30 540.00 180.00 ")


def test_without_prompts_the_model_finds_what_there_is(model: Monocular) -> None:
    (found,) = model.detect("a", grey(), camera()).objects
    assert found.prompt == Prompt("Car", (300, 90, 900, 270), 1.0)
    assert found.score == pytest.approx(128 / 255 / 2)
    assert model.detect("a", grey(), camera(), min_score=0.3).objects == ()
    assert len(model.detect("a", grey(), camera(), [CAR], min_score=0.3).objects) == 1
    assert model.detect("a", grey(), camera(), []).objects == ()


@pytest.mark.parametrize("scale", [0.5, 2.0, 1.03])
def test_another_focal_length_sees_the_same_objects(model: Monocular, scale: float) -> None:
    image = grey(round(1200 * scale), round(360 * scale))
    edges = [scale * edge + (scale - 1) / 2 for edge in CAR.box_px]
    prompt = Prompt("Car", (edges[0], edges[1], edges[2], edges[3]))
    (car,) = model.detect("a", image, camera(scale), [prompt]).objects
    (reference,) = model.detect("a", grey(), camera(), [CAR]).objects
    assert car.prompt == prompt
    assert car.box is not None
    assert reference.box is not None
    np.testing.assert_allclose(car.box.center_cam, reference.box.center_cam, atol=1e-4)
    (found,) = model.detect("a", image, camera(scale)).objects
    np.testing.assert_allclose(found.prompt.box_px, scale * np.array([300, 90, 900, 270]), atol=0.5)


@pytest.mark.parametrize(
    ("prompt", "result", "says"),
    [
        (Prompt("Tram", CAR.box_px), "CLASS_NOT_IN_MODEL", "'Tram' (it knows Car, Pedestrian)"),
        (Prompt("Car", (600, 200, 600, 250)), "BAD_BOX", "no area"),
        (Prompt("Car", (float("nan"), 0, 9, 9)), "BAD_BOX", "absurd"),
        (Prompt("Car", (1300, 0, 1400, 9)), "BOX_OUTSIDE_IMAGE", "1200 x 360"),
    ],
)
def test_an_unusable_prompt_has_a_sentence_and_costs_no_other(
    model: Monocular, prompt: Prompt, result: str, says: str
) -> None:
    unusable, car = model.detect("a", grey(), camera(), [prompt, CAR]).objects
    assert (unusable.index, unusable.result.name, unusable.box) == (0, result, None)
    assert says in unusable.sentence
    assert (car.index, car.result.name) == (1, "PREDICTED")
    assert [label.result.name for label in model.detect("a", grey(), camera(), [prompt]).objects] == [result]


def test_a_prompt_over_the_edge_is_cut_for_the_model_only(model: Monocular) -> None:
    prompt = Prompt("Car", (-50.0, 180.0, 60.0, 260.0))
    (car,) = model.detect("a", grey(), camera(), [prompt]).objects
    assert car.prompt == prompt
    assert car.box is not None
    assert car.box.center_cam[0, 0] == pytest.approx((30 - 600) / 700 * 700 * 1.5 / 80)
    assert "truncated" in car.flags


@pytest.mark.parametrize(
    ("height_m", "length_m", "says"),
    [
        (float("nan"), 4.0, "centre is not finite"),
        (float("inf"), 4.0, "centre is not finite"),
        (-1.0, 4.0, "centre is at"),
        (1.5, 0.0, "size is 0 x 1.7 x 1.5 m"),
        (1.5, 1e9, "size is 1e+09"),
    ],
)
def test_absurd_numbers_of_a_model_are_no_box(
    tmp_path: Path, height_m: float, length_m: float, says: str
) -> None:
    model = Monocular.open(stand_in_model(tmp_path / "odd.onnx", height_m=height_m, length_m=length_m))
    for prompts in (None, [CAR]):
        labels = model.detect("a", grey(), camera(), prompts)
        (label,) = labels.objects
        assert (label.result.name, label.box, label.score) == ("ABSURD_PREDICTION", None, 0)
        assert says in label.sentence
        assert kitti_label.objects_of(labels) == []


@pytest.mark.parametrize(
    ("metadata", "says"),
    [
        ({}, "no metadata property 'boxlift_interface'"),
        ({**METADATA, "boxlift_interface": "monocular/2"}, "'monocular/2', not 'monocular/1'"),
        ({**METADATA, "classes": "Car"}, "no JSON list"),
        ({**METADATA, "focal_px": "long"}, "no focal length"),
        ({**METADATA, "focal_px": "nan"}, "no focal length"),
    ],
)
def test_a_file_with_wrong_properties(tmp_path: Path, metadata: dict[str, str], says: str) -> None:
    with pytest.raises(ModelFileError, match=r"odd\.onnx") as caught:
        Monocular.open(stand_in_model(tmp_path / "odd.onnx", metadata=metadata))
    assert says in caught.value.problem


def test_a_model_that_knows_the_front_says_so(tmp_path: Path) -> None:
    path = stand_in_model(tmp_path / "odd.onnx", metadata={**METADATA, "heading_period": "2pi"})
    (car,) = Monocular.open(path).detect("a", grey(), camera(), [CAR]).objects
    assert car.flags == ()


@pytest.mark.parametrize(
    "focal", [1.0, 1e5, -700.0], ids=["wide as no lens", "narrow as no lens", "mirrored"]
)
def test_intrinsics_that_no_camera_has(model: Monocular, focal: float) -> None:
    image_P_cam = np.array([[focal, 0, 600, 0], [0, abs(focal), 180, 0], [0, 0, 1, 0]])
    with pytest.raises(CalibrationError, match=r"focal lengths .* would give 1200 pixels a view of"):
        model.detect("a", grey(), Calibration(image_P_cam, CAM_SE3_VELO))


def test_the_projection_of_another_image_is_a_warning(model: Monocular) -> None:
    labels = model.detect("a", grey(600, 180), camera())
    assert [warning.doubt.name for warning in labels.warnings] == ["IMAGE_SIZE"]


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((9, 9), np.uint8),
        np.zeros((9, 9, 4), np.uint8),
        np.zeros((9, 9, 3)),
        np.zeros((0, 9, 3), np.uint8),
    ],
    ids=["grey", "alpha", "float", "empty"],
)
def test_arrays_that_are_no_image(model: Monocular, image: NDArray[np.uint8]) -> None:
    with pytest.raises(ImageError, match="Give RGB"):
        model.detect("a", image, camera())


def test_views_of_arrays_are_images(model: Monocular) -> None:
    image = np.random.default_rng(0).integers(0, 256, (360, 1200, 3), np.uint8)
    for scale in (1.0, 2.0):
        expected = model.detect("a", image[:, ::-1].copy(), camera(scale), [CAR])
        assert (
            model.detect("a", image[:, ::-1], camera(scale), [CAR]).objects[0].score
            == expected.objects[0].score
        )
    image.setflags(write=False)
    assert model.detect("a", image, camera()).objects


def test_importing_it_loads_nothing_heavy() -> None:
    command = (
        "import sys; import boxlift.monocular; "
        "heavy = {'torch', 'open3d', 'onnxruntime', 'PIL'} & set(sys.modules); assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", command], check=True)
