"""Labels from images and points alone: the detector in this package, and a user's own."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from boxlift.datasets import load_prompts, open_source
from boxlift.datasets.generated import generate
from boxlift.detector import Detector, find_prompts
from boxlift.errors import ImageError, ModelFileError
from boxlift.formats import details
from boxlift.formats.calibration import parse_calibration, to_kitti_text
from boxlift.formats.image import image_size
from boxlift.labeller import Labeller
from boxlift.settings import ACCURATE
from boxlift_client import LabelJob, Outcome, label_dataset
from boxlift_client.client import Client
from boxlift_client.engines.http import HttpEngine
from boxlift_client.engines.local import LocalEngine
from boxlift_client.errors import RequestRefusedError
from clients.command import Boxlift
from clients.label_sets import files_of, text_at_its_place
from model.detector.detector_files import brightness_detector, detector_file


def details_of(out: Path, name: str) -> details.FrameDetails:
    return details.parse_text((out / "details" / f"{name}.json").read_text())


@pytest.fixture
def plain_folder(tmp_path: Path) -> Path:
    """Two frames, "city street" with a PNG and "b" with a JPEG, one calibration, no 2D box anywhere."""
    root = tmp_path / "mine"
    for folder in ("velodyne", "image_2"):
        (root / folder).mkdir(parents=True)
    for name, seed, suffix in (("city street", 3, "png"), ("b", 4, "jpg")):
        frame = generate(seed).frame
        assert frame.image is not None
        np.save(root / "velodyne" / f"{name}.npy", frame.points_velo)
        Image.fromarray(frame.image).save(root / "image_2" / f"{name}.{suffix}", quality=95)
    (root / "calib.txt").write_text(to_kitti_text(frame.calibration))
    return root


def test_a_plain_folder_needs_no_boxes(boxlift: Boxlift, plain_folder: Path, tmp_path: Path) -> None:
    ran = boxlift("label", plain_folder, "--out", tmp_path / "out")
    assert (ran.status, ran.err) == (0, "")
    assert ran.out.startswith("2 frames: 2 labelled, 0 skipped, 0 failed")
    labelled = details_of(tmp_path / "out", "city street")
    assert labelled.model_digest == Detector.open().digest
    assert sum(item.result == "FITTED" for item in labelled.objects) >= 4
    scores = [item.prompt_score for item in labelled.objects]
    assert scores == sorted(scores, reverse=True)
    assert scores[-1] >= ACCURATE.detection.min_score
    lines = (tmp_path / "out" / "data" / "city street.txt").read_text().splitlines()
    assert {len(line.split()) for line in lines} == {16}

    ran = boxlift("label", plain_folder, "--out", tmp_path / "few", "--min-score", 0.6, "--workers", 2)
    assert ran.status == 0
    few = details_of(tmp_path / "few", "city street")
    assert [item.prompt_score for item in few.objects] == [score for score in scores if score >= 0.6]

    picture = tmp_path / "a.png"
    ran = boxlift("show", plain_folder, "city street", "--out", picture, "--prompts", "detector")
    assert (ran.status, ran.err) == (0, "")
    shown = np.array(Image.open(picture))
    ran = boxlift("show", plain_folder, "city street", "--out", picture)
    assert not np.array_equal(np.array(Image.open(picture)), shown)


def test_the_same_bytes_for_any_number_of_workers_as_in_one_process(dataset: Path, tmp_path: Path) -> None:
    for workers in (1, 2):
        summary = label_dataset(LabelJob(dataset, tmp_path / str(workers)), LocalEngine(workers))
        assert summary.frames == {Outcome.LABELLED: 3}
    one, two = files_of(tmp_path / "1"), files_of(tmp_path / "2")
    assert len(one) == 7
    assert one == two
    detector, source = Detector.open(), open_source(dataset)
    for name in source.names:
        frame = find_prompts(source.load(name, with_image=True), detector, ACCURATE.detection)
        labels = details.details_of(Labeller().label(frame), detector.digest)
        written = one[f"details/{name}.json"]
        assert written.decode() == text_at_its_place(labels, written)


def test_over_http_as_here(dataset: Path, service_url: str, tmp_path: Path) -> None:
    settings = ACCURATE.with_options({"detection": {"min_score": 0.5}})
    for engine, out in ((HttpEngine(service_url), "http"), (LocalEngine(1), "local")):
        job = LabelJob(dataset, tmp_path / out, settings=settings)
        assert label_dataset(job, engine).frames == {Outcome.LABELLED: 3}
    assert files_of(tmp_path / "http") == files_of(tmp_path / "local")


def test_a_detector_with_masks_plugs_in(boxlift: Boxlift, dataset: Path, tmp_path: Path) -> None:
    root = tmp_path / "dataset"
    shutil.copytree(dataset, root)
    source = open_source(root)
    # One car of each frame is painted white on black, and the others are not seen.
    painted = {}
    for name in source.names:
        frame = source.load(name, load_prompts("label_2", source, name), masks=source.root / "masks")
        assert frame.instance_ids is not None
        cars = [index for index, prompt in enumerate(frame.prompts) if prompt.category == "Car"]
        pixels = np.bincount(frame.instance_ids.ravel(), minlength=len(frame.prompts) + 1)
        mask = frame.instance_ids == max(cars, key=lambda index: int(pixels[index + 1])) + 1
        image = np.where(mask[..., None], 255, 0).repeat(3, axis=-1).astype(np.uint8)
        Image.fromarray(image).save(str(source.root / "image_2" / f"{name}.png"))
        rows, columns = np.nonzero(mask)
        painted[name] = (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)
    own = brightness_detector(tmp_path / "own.onnx")
    ran = boxlift("label", root, "--out", tmp_path / "out", "--detector", own)
    assert (ran.status, ran.err) == (0, "")
    for name, box_px in painted.items():
        labelled = details_of(tmp_path / "out", name)
        (item,) = labelled.objects
        assert (item.category, item.prompt_score, item.result) == ("Car", 0.9, "FITTED")
        assert item.prompt_box_px == box_px
        assert labelled.model_digest == Detector.open(own).digest


def test_frames_that_cannot_be_looked_at(plain_folder: Path, tmp_path: Path) -> None:
    images = plain_folder / "image_2"
    width, height = image_size(images / "b.jpg")
    for name in ("no image", "damaged", "no points"):
        if name != "no points":
            shutil.copy(plain_folder / "velodyne" / "b.npy", plain_folder / "velodyne" / f"{name}.npy")
        if name != "no image":
            shutil.copy(images / "b.jpg", images / f"{name}.jpg")
    (images / "damaged.jpg").write_bytes((images / "b.jpg").read_bytes()[:20_000])
    calib = (plain_folder / "calib.txt").read_text()
    (plain_folder / "calib").mkdir()
    (plain_folder / "calib" / "no image.json").write_text(_as_json(calib, width, height))

    summary = label_dataset(LabelJob(plain_folder, tmp_path / "out"), LocalEngine(1))
    assert summary.frames == {Outcome.LABELLED: 2, Outcome.FAILED: 2, Outcome.SKIPPED: 1}
    sentences = {report.frame: report.sentence for report in summary.unlabelled}
    assert "frame 'no image' has no image to find objects in." in sentences["no image"]
    assert "the image cannot be decoded" in sentences["damaged"]
    assert "has no LiDAR points" in sentences["no points"]
    assert (tmp_path / "out" / "data" / "no points.txt").read_text() == ""
    assert details_of(tmp_path / "out", "no points").objects == ()


def _as_json(kitti_text: str, width: int, height: int) -> str:
    calibration = parse_calibration(kitti_text).calibration
    p2, cam_T_velo = calibration.image_P_cam.tolist(), calibration.cam_SE3_velo.tolist()
    return f'{{"P2": {p2}, "cam_T_velo": {cam_T_velo}, "image_size": [{width}, {height}]}}'


def test_a_model_that_fails_costs_its_frames_only(dataset: Path, tmp_path: Path) -> None:
    own = detector_file(tmp_path / "own.onnx", [(1, 2, 3, 4)], [7.0], [0])
    summary = label_dataset(LabelJob(dataset, tmp_path / "out", detector=own), LocalEngine(1))
    assert summary.frames == {Outcome.FAILED: 3}
    assert "some of its scores lie outside 0 to 1" in summary.unlabelled[0].sentence


def test_a_file_that_is_no_detector_is_one_error(dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(ModelFileError, match="the path does not exist"):
        label_dataset(LabelJob(dataset, tmp_path, detector=tmp_path / "no.onnx"), LocalEngine(2))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--detector", "no.onnx"], "no.onnx: the path does not exist. Give the path of an ONNX model."),
        (["--detector", "TEXT"], "TEXT: ONNX Runtime cannot load it ("),
        (["--detector", "m.onnx", "--prompts", "label_2"], "detector: 'm.onnx' is given without --prompts"),
        (["--min-score", "0.5", "--prompts", "label_2"], "min-score: '0.5' is given without --prompts det"),
        (["--masks", "masks"], "masks: masks number prompts that are given; give --prompts too."),
        (
            ["--detector", "m.onnx", "--engine", "http"],
            "detector: the service has its own; give it to boxlift",
        ),
    ],
)
def test_wrong_options_are_one_line(
    boxlift: Boxlift, dataset: Path, tmp_path: Path, arguments: list[str], message: str
) -> None:
    text = tmp_path / "text.onnx"
    text.write_text("# no model\n" * 100)
    given = [str(text) if word == "TEXT" else word for word in arguments]
    ran = boxlift("label", dataset, "--out", tmp_path / "out", *given)
    assert (ran.status, ran.out) == (2, "")
    assert ran.err.startswith(f"error: {message.replace('TEXT', str(text))}")
    assert ran.err.count("\n") == 1
    assert not list(tmp_path.glob("out/*/*"))
    if "http" not in arguments and "--masks" not in arguments:
        ran = boxlift("show", dataset, "000000", "--out", tmp_path / "a.png", "--prompts", "detector", *given)
        assert ran.status == 2
        assert ran.err.startswith(f"error: {message.replace('TEXT', str(text))}")


def test_a_client_sends_the_image_alone(dataset: Path, service_url: str) -> None:
    split = dataset / "training"
    frame = open_source(dataset).load("000001", with_image=True)
    with Client(service_url) as client:
        by_frame = client.label(frame, ACCURATE, detect=True)
        by_files = client.label_files(
            split / "velodyne" / "000001.bin",
            split / "calib" / "000001.txt",
            image=split / "image_2" / "000001.png",
        )
        with pytest.raises(RequestRefusedError, match="image: "):
            client.label_files(split / "velodyne" / "000001.bin", split / "calib" / "000001.txt")
        with pytest.raises(ImageError, match="frame '000001' has no image to find objects in"):
            client.label(replace(frame, image=None), ACCURATE, detect=True)
    detector = Detector.open()
    here = Labeller().label(find_prompts(frame, detector, ACCURATE.detection))
    assert by_frame.details == by_files.details == details.details_of(here, detector.digest)
    assert by_frame.model_digest == detector.digest
