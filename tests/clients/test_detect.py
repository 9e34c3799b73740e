"""Detecting in images by the CLI and the client, with the hand-made model."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from boxlift import Prompt
from boxlift.datasets import open_images
from boxlift.errors import ImageError, InputError
from boxlift.formats import details
from boxlift.formats.image import decode_image
from boxlift.monocular import Monocular
from boxlift_client import Outcome
from boxlift_client.client import Client
from boxlift_client.detect_job import DetectJob
from boxlift_client.engines.detection import HttpDetectEngine, LocalDetectEngine
from boxlift_client.errors import RequestRefusedError, ServiceUnreachableError
from boxlift_client.runner import detect_images
from boxlift_client.service_process import running_service
from clients.command import Boxlift
from model.stand_in_model import stand_in_model


@pytest.fixture(scope="module")
def model_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return stand_in_model(tmp_path_factory.mktemp("model") / "hand_made.onnx")


@pytest.fixture(scope="module")
def url(model_path: Path) -> Iterator[str]:
    os.environ["BOXLIFT_MODEL"] = str(model_path)
    try:
        with running_service() as url:
            yield url
    finally:
        del os.environ["BOXLIFT_MODEL"]


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("prompts", [None, "label_2"])
def test_both_engines_write_the_same_bytes(
    dataset: Path, model_path: Path, url: str, tmp_path: Path, prompts: str | None
) -> None:
    for name, engine in (("here", LocalDetectEngine(model_path)), ("there", HttpDetectEngine(url))):
        summary = detect_images(DetectJob(dataset, tmp_path / name, prompts=prompts), engine)
        assert summary.frames == {Outcome.LABELLED: 3}
    assert len(contents(tmp_path / "here")) == 6
    assert contents(tmp_path / "here") == contents(tmp_path / "there")
    written = details.parse_text((tmp_path / "here" / "details" / "000000.json").read_bytes())
    assert written.model_digest == Monocular.open(model_path).digest
    assert {"PREDICTED"} <= {item.result for item in written.objects} <= {"PREDICTED", "CLASS_NOT_IN_MODEL"}


@pytest.mark.parametrize("engine", ["local", "http"])
def test_detect_evaluate(
    boxlift: Boxlift, dataset: Path, model_path: Path, url: str, tmp_path: Path, engine: str
) -> None:
    out, frames = tmp_path / "out", tmp_path / "frames.txt"
    frames.write_text("000000\n000002\n")
    where = ("--model", model_path) if engine == "local" else ("--engine", "http", "--url", url)
    ran = boxlift("detect", dataset, "--out", out, "--prompts", "label_2", "--frames", frames, *where)
    assert (ran.status, ran.err) == (0, "")
    assert ran.out.startswith("2 frames: 2 labelled, 0 skipped, 0 failed")
    assert "objects:\n" in ran.out
    assert "PREDICTED" in ran.out
    assert sorted(path.name for path in (out / "data").iterdir()) == ["000000.txt", "000002.txt"]
    truth = dataset / "training" / "label_2"
    assert boxlift("evaluate", "--gt", truth, "--pred", out, "--frames", frames).status == 0
    ran = boxlift("show", dataset, "000000", "--pred", out, "--out", tmp_path / "a.png")
    assert (ran.status, ran.err) == (0, "")


def test_a_single_image_with_a_calibration(
    boxlift: Boxlift, dataset: Path, model_path: Path, tmp_path: Path
) -> None:
    image = tmp_path / "street.jpg"
    Image.open(dataset / "training" / "image_2" / "000001.png").save(image)
    calib = dataset / "training" / "calib" / "000001.txt"
    ran = boxlift("detect", image, "--calib", calib, "--out", tmp_path / "out", "--model", model_path)
    assert (ran.status, ran.err) == (0, "")
    assert (tmp_path / "out" / "data" / "street.txt").read_text().startswith("Car ")
    ran = boxlift(
        "detect", image, "--calib", calib, "--out", tmp_path / "none", "--model", model_path, "--min-score", 1
    )
    assert ran.status == 0
    assert (tmp_path / "none" / "data" / "street.txt").read_text() == ""


@pytest.mark.parametrize("engine", ["local", "http"])
def test_what_is_wrong_with_an_image_costs_no_other(
    boxlift: Boxlift, dataset: Path, model_path: Path, url: str, tmp_path: Path, engine: str
) -> None:
    root = tmp_path / "dataset"
    shutil.copytree(dataset, root)
    images, calibs = root / "training" / "image_2", root / "training" / "calib"
    whole, calib = (images / "000000.png").read_bytes(), (calibs / "000000.txt").read_text()
    for name in ("truncated", "text", "no_calib", "nan_calib", "absurd_calib", "wrong_size"):
        (images / f"{name}.png").write_bytes(whole)
        (calibs / f"{name}.txt").write_text(calib)
    (images / "truncated.png").write_bytes(whole[:-5000])
    (images / "text.png").write_text("no image")
    (calibs / "no_calib.txt").unlink()
    (calibs / "nan_calib.txt").write_text("P2: " + "nan " * 12)
    (calibs / "absurd_calib.txt").write_text("P2: 1 0 600 0 0 1 180 0 0 0 1 0")
    (calibs / "wrong_size.txt").unlink()
    camera = [[700, 0, 600, 0], [0, 700, 180, 0], [0, 0, 1, 0]]
    (calibs / "wrong_size.json").write_text(json.dumps({"P2": camera, "image_size": [7, 5]}))

    where = ("--model", model_path) if engine == "local" else ("--engine", "http", "--url", url)
    ran = boxlift("detect", root, "--out", tmp_path / "out", *where)
    assert ran.status == 1
    assert ran.out.startswith("9 frames: 3 labelled, 0 skipped, 6 failed")
    for name, says in {
        "truncated": "cannot be decoded",
        "text": "no PNG or JPEG",
        "no_calib": "has no calibration",
        "nan_calib": "P2: ",
        "absurd_calib": "a view of 180 degrees",
        "wrong_size": "it is (7, 5)",
    }.items():
        (line,) = [line for line in ran.out.splitlines() if line.startswith(f"  failed {name}: ")]
        assert says in line
    assert len(list((tmp_path / "out" / "data").iterdir())) == 3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "nowhere: there is no such file or folder."),
        (["SOURCE", "--calib", "nowhere"], "nowhere: the calibration does not exist."),
        (["SOURCE", "--prompts", "nowhere"], "nowhere: there is no such folder"),
        (["SOURCE", "--model", "nowhere.onnx"], "nowhere.onnx: the path does not exist."),
        (["SOURCE", "--model", "README.md"], "README.md: ONNX Runtime cannot load it"),
        (["SOURCE", "--frames", "nowhere"], "frames: 'nowhere' cannot be read"),
        (["SOURCE", "--url", "http://x"], "url: 'http://x' is given to the local engine."),
        (["SOURCE", "--engine", "http", "--model", "a.onnx"], "model: the service has its own;"),
        (["SOURCE", "--engine", "http", "--threads", "2"], "threads: the service has its own;"),
        (
            ["SOURCE", "--engine", "http", "--url", "http://127.0.0.1:9"],
            "http://127.0.0.1:9: no boxlift service answers",
        ),
    ],
)
def test_wrong_input_is_one_line_and_exit_status_2(
    boxlift: Boxlift, dataset: Path, tmp_path: Path, arguments: list[str], message: str
) -> None:
    given = [str(dataset) if word == "SOURCE" else word for word in arguments]
    ran = boxlift("detect", *given, "--out", tmp_path / "out")
    assert ran.status == 2
    assert ran.out == ""
    assert ran.err.startswith(f"error: {message}")
    assert ran.err.count("\n") == 1
    assert not list(tmp_path.glob("out/*/*"))


def test_the_client_sends_arrays_and_files(dataset: Path, model_path: Path, url: str) -> None:
    folder = open_images(dataset)
    paths = [folder.image_path(name) for name in folder.names]
    calibs = [folder.calibration_path(name) for name in folder.names]
    image, camera = decode_image(paths[0]), folder.camera("000000").calibration
    prompts = (Prompt("Car", (540.0, 180.0, 660.0, 260.0), 0.5), Prompt("Tram", (1.0, 2.0, 3.0, 4.0)))
    with Client(url) as client:
        for given in (None, prompts, ()):
            answer = client.detect(image, camera, given, name="mine")
            labels = Monocular.open(model_path).detect("mine", image, camera, given)
            expected = details.details_of(labels, answer.model.digest)
            assert answer.details(0, "mine") == expected
            assert answer.images[0].image_size == (image.shape[1], image.shape[0])
            assert answer.images[0].kitti_text == details.kitti_text(expected)
        assert client.detect(image, camera, min_score=1.0).images[0].objects == ()

        answer = client.detect_files(paths, calibs)
        assert [found.frame for found in answer.images] == list(folder.names)
        alone = client.detect_files([paths[1].read_bytes()], [calibs[1].read_bytes()], names=["a.b"])
        assert alone.images[0].frame == "a.b"
        assert alone.images[0].objects == answer.images[1].objects
        lifted = client.detect_files(paths, calibs[:1], [prompts, (), prompts[:1]])
        assert [len(found.objects) for found in lifted.images] == [2, 0, 1]

        with pytest.raises(RequestRefusedError, match=r"image\[1\]"):
            client.detect_files([paths[0], b"text"], calibs[:1])
        with pytest.raises(InputError, match=r"image: .*nowhere\.png.* cannot be read"):
            client.detect_files([Path("nowhere.png")], calibs[:1])
        with pytest.raises(ImageError, match="Give uint8"):
            client.detect(np.zeros((4, 4), np.uint8), camera)


def test_no_service_is_one_error(dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(ServiceUnreachableError):
        detect_images(DetectJob(dataset, tmp_path), HttpDetectEngine("http://127.0.0.1:9"))
