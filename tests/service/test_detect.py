from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import boxlift
from boxlift import Calibration
from boxlift.detector import Detector
from boxlift.formats import details, kitti_label
from boxlift.formats.image import decode_image
from boxlift.formats.prompts import parse_prompts
from boxlift.monocular import Monocular
from boxlift_service.answers import DetectAnswer
from model.detector.detector_files import detector_file
from service.frames import CAM_T_VELO, CAR, HEIGHT, P2, WIDTH, calib_json, calib_text, detect_parts, grey_png
from service.running import RunningService, running_service

PEDESTRIAN = {"class": "Pedestrian", "box": [700, 150, 740, 250]}
PROMPTS = json.dumps([CAR, PEDESTRIAN]).encode()


def test_one_image_without_prompts(service: RunningService, model_path: Path) -> None:
    response = service.detect(detect_parts(grey_png()))
    assert response.status_code == 200
    answer = DetectAnswer.model_validate_json(response.content)
    (image,) = answer.images
    assert (image.frame, image.image_size, image.warnings) == ("0", (WIDTH, HEIGHT), ())
    (found,) = image.objects
    assert (found.result, found.category, found.depth_spread) == ("PREDICTED", "Car", 0.05)
    assert found.kitti is not None
    assert found.kitti.bbox == found.prompt_box_px == (300, 90, 900, 270)
    model = Monocular.open(model_path)
    assert (answer.model.name, answer.model.digest) == ("hand_made", model.digest)
    assert answer.detector is None
    assert answer.boxlift_version == boxlift.__version__


def test_what_is_answered_is_what_the_model_says_here(service: RunningService, model_path: Path) -> None:
    calibration = Calibration(np.array(P2), np.array(CAM_T_VELO))
    prompts = parse_prompts(PROMPTS)
    labels = Monocular.open(model_path).detect("0", decode_image(grey_png(90)), calibration, prompts)
    parts = detect_parts(grey_png(90), prompts=PROMPTS)
    (image,) = DetectAnswer.model_validate_json(service.detect(parts).content).images
    assert image.objects == details.details_of(labels).objects
    text = service.detect(parts, accept="text/plain")
    assert text.headers["content-type"] == "text/plain; charset=utf-8"
    assert text.text == kitti_label.to_text(kitti_label.objects_of(labels))


def test_the_camera_is_enough_of_a_calibration(service: RunningService) -> None:
    answers = [
        service.detect(detect_parts(grey_png(), calib=calib)).json()
        for calib in (
            calib_text(),
            calib_json(),
            json.dumps({"P2": P2}).encode(),
            b"P2: 700 0 600 0 0 700 180 0 0 0 1 0",
            b"P2: 700 0 600 0 0 700 180 0 0 0 1 0\nTr_velo_to_cam: broken",
        )
    ]
    assert answers[0]["images"][0]["objects"]
    assert all(answer == answers[0] for answer in answers)


def test_several_images_with_one_camera_or_one_each(service: RunningService) -> None:
    images = [grey_png(value) for value in (40, 80, 120)]
    together = service.detect(detect_parts(*images)).json()["images"]
    assert [image["frame"] for image in together] == ["0", "1", "2"]
    scores = [image["objects"][0]["score"] for image in together]
    assert scores == sorted(set(scores))
    for index, image in enumerate(images):
        (alone,) = service.detect(detect_parts(image)).json()["images"]
        assert alone["objects"] == together[index]["objects"]

    wide = json.dumps({"P2": [[350.0, 0, 600, 0], [0, 350, 180, 0], [0, 0, 1, 0]]}).encode()
    parts = detect_parts(*images[:2])
    parts.append(("calib", (None, wide)))
    first, second = service.detect(parts).json()["images"]
    assert first["objects"] == together[0]["objects"]
    assert second["objects"][0]["box"] != together[1]["objects"][0]["box"]

    lists = json.dumps([[CAR], [], [PEDESTRIAN, CAR]]).encode()
    answer = service.detect(detect_parts(*images, prompts=lists)).json()["images"]
    assert [[item["class"] for item in image["objects"]] for image in answer] == [
        ["Car"],
        [],
        ["Pedestrian", "Car"],
    ]


def test_kitti_lines_are_for_one_image(service: RunningService) -> None:
    parts = detect_parts(grey_png(), grey_png())
    response = service.detect(parts, accept="text/plain")
    assert response.status_code == 406
    assert response.json()["remedy"] == "Accept one of application/json."
    response = service.detect(parts, accept="text/plain, application/json;q=0.5")
    assert response.headers["content-type"] == "application/json"


def test_names_of_images(service: RunningService) -> None:
    def names(*filenames: str | None) -> list[str]:
        parts = [("image", (filename, grey_png(9, 40, 40))) for filename in filenames]
        camera = json.dumps({"P2": [[30.0, 0, 20, 0], [0, 30, 20, 0], [0, 0, 1, 0]]}).encode()
        answer = service.detect([*parts, ("calib", (None, camera))])
        return [image["frame"] for image in answer.json()["images"]]

    assert names("a/b/000042.png") == ["000042"]
    assert names(None) == ["frame"]
    assert names("x.tar.jpg", None, "x.tar.jpg") == ["x.tar", "frame-1", "x.tar"]


def test_a_least_score(service: RunningService) -> None:
    parts = detect_parts(grey_png(200), min_score=b"0.5")
    assert service.detect(parts).json()["images"][0]["objects"] == []
    parts = detect_parts(grey_png(200), min_score=b"0.5", prompts=PROMPTS)
    assert len(service.detect(parts).json()["images"][0]["objects"]) == 2
    parts = detect_parts(grey_png(200), min_score=b"0.3")
    assert len(service.detect(parts).json()["images"][0]["objects"]) == 1


@pytest.mark.parametrize(
    ("prompt", "result"),
    [
        ({"class": "Car", "box": [600, 200, 600, 200]}, "BAD_BOX"),
        ({"class": "Car", "box": [1300, 10, 1400, 60]}, "BOX_OUTSIDE_IMAGE"),
        ({"class": "Tram", "box": [540, 180, 660, 260]}, "CLASS_NOT_IN_MODEL"),
    ],
)
def test_an_unusable_prompt_has_a_sentence_and_fails_no_other(
    service: RunningService, prompt: dict[str, object], result: str
) -> None:
    response = service.detect(detect_parts(grey_png(), prompts=json.dumps([prompt, CAR]).encode()))
    assert response.status_code == 200
    unusable, car = response.json()["images"][0]["objects"]
    assert (unusable["result"], unusable["box"]) == (result, None)
    assert unusable["sentence"]
    assert car["result"] == "PREDICTED"


def test_the_projection_of_another_image_is_a_warning(service: RunningService) -> None:
    half = grey_png(width=WIDTH // 2, height=HEIGHT // 2)
    response = service.detect(detect_parts(half, calib=calib_text()))
    assert [warning["name"] for warning in response.json()["images"][0]["warnings"]] == ["IMAGE_SIZE"]


def test_server_timing_tells_every_stage(service: RunningService) -> None:
    header = service.detect(detect_parts(grey_png(), grey_png())).headers["server-timing"]
    stages = dict(stage.split(";dur=") for stage in header.split(", "))
    assert list(stages) == ["receive", "queue", "decode", "resize", "network", "encode", "total"]
    durations = {name: float(duration) for name, duration in stages.items()}
    stages_ms = sum(durations.values()) - durations["total"]
    assert durations["network"] < stages_ms < durations["total"]


def test_concurrent_requests_get_their_own_answers(service: RunningService) -> None:
    def detect(value: int) -> float:
        answer = service.detect(detect_parts(grey_png(value))).json()
        return float(answer["images"][0]["objects"][0]["score"])

    with ThreadPoolExecutor(6) as pool:
        together = list(pool.map(detect, range(0, 250, 10)))
    assert together == [detect(value) for value in range(0, 250, 10)]


def test_a_detector_of_ones_own_also_looks_for_the_monocular_model(model_path: Path, tmp_path: Path) -> None:
    boxes: list[tuple[float, float, float, float]] = [(540, 180, 660, 260), (700, 150, 740, 250)]
    own = detector_file(tmp_path / "own.onnx", boxes, [0.9, 0.8], [0, 1], classes=["Car", "Tram"])
    with running_service(model=str(model_path), detector=str(own)) as service:
        response = service.detect(detect_parts(grey_png()))
        answer = DetectAnswer.model_validate_json(response.content)
        assert answer.detector is not None
        assert (answer.detector.name, answer.detector.digest) == ("own", Detector.open(own).digest)
        car, tram = answer.images[0].objects
        assert (car.result, car.prompt_box_px, car.prompt_score) == ("PREDICTED", boxes[0], 0.9)
        assert (tram.result, tram.box) == ("CLASS_NOT_IN_MODEL", None)
        assert "detect;dur=" in response.headers["server-timing"]
        prompted = service.detect(detect_parts(grey_png(), prompts=b"[]"))
        assert prompted.json()["detector"] is None
