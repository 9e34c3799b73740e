"""The detector in this package: generated pictures, real ones, odd ones."""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from boxlift import Prompt
from boxlift.datasets import load_objects, open_source
from boxlift.datasets.generated import generate
from boxlift.detector import DEFAULT_FILE, Detector
from boxlift.formats.image import decode_image
from boxlift.overlap import iou_2d
from boxlift.priors import SIZE_PRIORS


@pytest.fixture(scope="module")
def detector() -> Detector:
    return Detector.open()


def test_what_it_is(detector: Detector) -> None:
    assert detector.name == "nanodet_g"
    assert {"Car", "Pedestrian", "Cyclist"} <= set(detector.class_names) <= SIZE_PRIORS.keys()
    assert DEFAULT_FILE.stat().st_size < 10e6
    beside = {path.name for path in DEFAULT_FILE.parent.iterdir()}
    assert {"README.md", "LICENSE-nanodet.txt", "LICENSE-human-models.txt"} <= beside


def found_of(prompts: tuple[Prompt, ...], box_px: tuple[float, ...], categories: set[str]) -> bool:
    """Whether one of the prompts is of these classes and has an IoU of .5 with the box."""
    boxes = np.array([prompt.box_px for prompt in prompts if prompt.category in categories]).reshape(-1, 4)
    return bool((iou_2d(boxes, np.broadcast_to(np.array(box_px), boxes.shape)) >= 0.5).any())


def test_generated_pictures(detector: Detector) -> None:
    found: Counter[str] = Counter()
    asked: Counter[str] = Counter()
    for seed in range(4):
        generated = generate(seed)
        assert generated.frame.image is not None
        prompts = detector.detect(generated.frame.image).prompts
        for truth in generated.truth:
            height = truth.box_px[3] - truth.box_px[1]
            if truth.category in detector.class_names and height >= 40 and not truth.occluded:
                asked[truth.category] += 1
                found[truth.category] += found_of(prompts, truth.box_px, {truth.category})
    assert asked["Car"] >= 5
    assert found["Car"] / asked["Car"] > 0.6
    assert found["Pedestrian"] + found["Cyclist"] > 0.6 * (asked["Pedestrian"] + asked["Cyclist"])


def test_real_pictures(detector: Detector, kitti_object_root: Path) -> None:
    """The recall of cars by KITTI's easy and moderate difficulty, at IoU .5."""
    source = open_source(kitti_object_root)
    found: Counter[str] = Counter()
    asked: Counter[str] = Counter()
    wrong = right = 0
    for name in source.names:
        prompts = detector.detect(decode_image(source.root / "image_2" / f"{name}.png")).prompts
        labels = load_objects("label_2", source, name)
        for truth in labels:
            height = truth.box_px[3] - truth.box_px[1]
            if truth.category != "Car" or height < 25 or truth.occluded > 1 or truth.truncated > 0.3:
                continue
            easy = height >= 40 and truth.occluded == 0 and truth.truncated <= 0.15
            asked["easy" if easy else "moderate"] += 1
            found["easy" if easy else "moderate"] += found_of(prompts, truth.box_px, {"Car"})
        for prompt in (prompt for prompt in prompts if prompt.category == "Car" and prompt.score >= 0.5):
            near = [label.box_px for label in labels if iou_with(prompt, label.box_px) >= 0.5]
            right += bool(near)
            wrong += not near
        assert detector.detect(decode_image(source.root / "image_2" / f"{name}.png")).prompts == prompts
    assert found["easy"] / asked["easy"] > 0.95
    assert found["moderate"] / asked["moderate"] > 0.85
    assert right / (right + wrong) > 0.7


def iou_with(prompt: Prompt, box_px: tuple[float, float, float, float]) -> float:
    return float(iou_2d(np.array([prompt.box_px]), np.array([box_px]))[0])


def test_a_camera_of_many_pixels_sees_the_same(detector: Detector) -> None:
    image = generate(4).frame.image
    assert image is not None
    few = detector.detect(image, min_score=0.5).prompts
    many = detector.detect(image.repeat(3, axis=0).repeat(3, axis=1), min_score=0.4).prompts
    assert len(few) >= 4
    for prompt in few:
        assert found_of(many, tuple(3 * edge for edge in prompt.box_px), {prompt.category})


@pytest.mark.parametrize("size", [(1, 1), (1, 900), (900, 1), (31, 33), (32, 32), (375, 1242), (6000, 8000)])
def test_any_size(detector: Detector, size: tuple[int, int]) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (*size, 3), np.uint8)
    for image in (noise, np.zeros_like(noise), np.full_like(noise, 255)):
        for prompt in detector.detect(image, min_score=0.0).prompts:
            x1, y1, x2, y2 = prompt.box_px
            assert 0 <= x1 < x2 <= size[1]
            assert 0 <= y1 < y2 <= size[0]
            assert 0 < prompt.score <= 1


def test_no_object_inside_another_of_its_class(detector: Detector, kitti_object_root: Path) -> None:
    """Suppression is in the graph: no two of a class overlap much."""
    source = open_source(kitti_object_root)
    for name in source.names[:8]:
        prompts = detector.detect(decode_image(source.root / "image_2" / f"{name}.png")).prompts
        boxes = np.array([prompt.box_px for prompt in prompts])
        for index, prompt in enumerate(prompts):
            same = [i for i, p in enumerate(prompts) if i > index and p.category == prompt.category]
            overlaps = iou_2d(boxes[same], np.broadcast_to(boxes[index], (len(same), 4)))
            assert (overlaps < 0.7).all()


def test_the_same_in_two_threads_and_in_another_process(detector: Detector) -> None:
    image = generate(1).frame.image
    assert image is not None
    prompts = detector.detect(image).prompts
    assert Detector.open(threads=2).detect(image).prompts == prompts
    code = (
        "from boxlift.datasets.generated import generate; from boxlift.detector import Detector; "
        "print(Detector.open().detect(generate(1).frame.image).prompts)"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == str(prompts)
