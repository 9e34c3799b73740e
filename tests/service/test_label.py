from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import boxlift
from boxlift import Calibration, Frame, preset
from boxlift.detector import Detector
from boxlift.formats import details, kitti_label
from boxlift.formats.calibration import read_calibration
from boxlift.formats.image import decode_image, image_size
from boxlift.formats.point_cloud import read_points
from boxlift.formats.prompts import parse_prompts, to_json
from boxlift.labeller import Labeller
from boxlift.priors import SizePrior
from boxlift_service import ServiceSettings
from boxlift_service.answers import LabelAnswer
from boxlift_service.bodies.shared_parts import Part
from boxlift_service.labelling.decoding import decode_label_request
from service.frames import (
    CAM_T_VELO,
    CAR,
    HEIGHT,
    P2,
    WIDTH,
    Fields,
    SmallFrame,
    calib_json,
    calib_text,
    kitti_bin,
    mask_png,
    png,
)
from service.running import RunningService


def local_frame(frame: SmallFrame, name: str) -> Frame:
    calibration = Calibration(np.array(P2), np.array(CAM_T_VELO))
    prompts = parse_prompts(json.dumps([CAR]))
    return Frame(name, frame.points_velo, calibration, (WIDTH, HEIGHT), prompts)


def test_json_answer_has_the_box_and_how_it_was_made(service: RunningService, frame: SmallFrame) -> None:
    response = service.label(frame.fields())
    assert response.status_code == 200
    assert response.headers["content-type"] == "application/json"
    answer = LabelAnswer.model_validate_json(response.content)
    (car,) = answer.objects
    assert car.result == "FITTED"
    assert car.kitti is not None
    assert car.box is not None
    x, _, z = car.box.center_cam
    assert abs(x) < 0.5
    assert 15 < z < 19
    assert car.kitti.bbox == (540, 180, 660, 260)
    assert car.prompt_score == 0.9
    assert answer.frame == "small"
    assert answer.dropped_points == 0
    assert answer.preset == "accurate"
    assert answer.settings_fingerprint == preset("accurate").fingerprint()
    assert answer.model_digest is None
    assert answer.boxlift_version == boxlift.__version__
    assert json.loads(response.content)["objects"][0]["class"] == "Car"


def test_http_and_local_labels_are_the_same_bytes(service: RunningService, frame: SmallFrame) -> None:
    labels = Labeller().label(local_frame(frame, "000123"))
    response = service.label(frame.fields(name=b"000123"))
    expected = details.details_of(labels).objects
    assert LabelAnswer.model_validate_json(response.content).objects == expected
    text = service.label(frame.fields(name=b"000123"), accept="text/plain")
    assert text.headers["content-type"] == "text/plain; charset=utf-8"
    assert text.text == kitti_label.to_text(kitti_label.objects_of(labels))


def test_the_name_is_the_file_name_of_the_points_by_default(
    service: RunningService, frame: SmallFrame
) -> None:
    fields = frame.fields()
    for filename, name in (
        ("a/b/000042.bin", "000042"),
        ("x.tar.bin", "x.tar"),
        ("", "frame"),
        (None, "frame"),
    ):
        fields["points"] = (filename, fields["points"][1])
        assert service.label(fields).json()["frame"] == name


def test_fields_may_be_files_or_text(service: RunningService, frame: SmallFrame) -> None:
    as_text = frame.fields()
    as_files: Fields = {name: (f"{name}.dat", data) for name, (_, data) in as_text.items()}
    as_files["points"] = as_text["points"]
    assert service.label(as_files).json() == service.label(as_text).json()


def test_options_choose_preset_and_settings(service: RunningService, frame: SmallFrame) -> None:
    options = {"preset": "release", "fit": {"method": "adam"}}
    answer = service.label(frame.fields(options=json.dumps(options).encode())).json()
    expected = preset("release").with_options({"fit": {"method": "adam"}})
    assert answer["preset"] == "release"
    assert answer["settings_fingerprint"] == expected.fingerprint()
    whole = json.dumps(expected.model_dump()).encode()
    assert service.label(frame.fields(options=whole)).json() == answer


def test_options_declare_a_class(service: RunningService, frame: SmallFrame) -> None:
    taxi = {"height_m": 1.5, "width_m": 1.7, "length_m": 4.5, "source": "Measured."}
    fixed = {"repairs": {"size": "fixed"}}
    prompts = json.dumps([CAR | {"class": "Taxi"}]).encode()
    answer = service.label(
        frame.fields(prompts=prompts, options=json.dumps({"sizes": {"Taxi": taxi}, **fixed}).encode())
    ).json()
    assert answer["objects"][0]["kitti"]["dimensions"] == [1.5, 1.7, 4.5]
    assert (
        answer["settings_fingerprint"]
        == preset("accurate").with_options({"sizes": {"Taxi": taxi}, **fixed}).fingerprint()
    )
    del taxi["source"]
    refused = service.label(frame.fields(options=json.dumps({"sizes": {"Taxi": taxi}}).encode()))
    assert (refused.status_code, refused.json()["field"]) == (422, "options.sizes.Taxi.source")


def test_requests_start_from_the_services_own_classes(frame: SmallFrame) -> None:
    tram, bus = (
        SizePrior(height_m=3, width_m=2.5, length_m=length, source="Data sheet.") for length in (30, 12)
    )
    presets = {"accurate": preset("accurate").with_sizes({"Tram": tram})}

    def sizes(options: dict[str, object]) -> dict[str, SizePrior]:
        fields = frame.fields(options=json.dumps(options).encode())
        parts = {name: Part(data, filename) for name, (filename, data) in fields.items()}
        return decode_label_request(parts, ServiceSettings(), presets).settings.sizes

    assert sizes({"fit": {"method": "adam"}})["Tram"] == tram
    # A request that declares sizes means the same at every service.
    declared = sizes({"sizes": {"Bus": bus.model_dump()}})
    assert declared["Bus"] == bus
    assert "Tram" not in declared


def test_kitti_calibration_with_an_image(service: RunningService, frame: SmallFrame) -> None:
    image = png(np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    with_image = service.label(frame.fields(calib=calib_text(), image=image))
    assert with_image.status_code == 200
    assert with_image.json() == service.label(frame.fields()).json()


def test_only_points_in_the_mask_count(service: RunningService, frame: SmallFrame) -> None:
    left_half = service.label(frame.fields(masks=mask_png(0, 0, 600, HEIGHT))).json()["objects"][0]
    whole = service.label(frame.fields(masks=mask_png(0, 0, WIDTH, HEIGHT))).json()["objects"][0]
    without = service.label(frame.fields()).json()["objects"][0]
    assert whole == without
    assert 10 < left_half["points"]["in_prompt"] < 0.8 * whole["points"]["in_prompt"]
    assert left_half["box"] != whole["box"]


def test_masks_give_the_image_size_where_nothing_else_does(
    service: RunningService, frame: SmallFrame
) -> None:
    response = service.label(frame.fields(calib=calib_text(), masks=mask_png(0, 0, WIDTH, HEIGHT)))
    assert response.status_code == 200
    assert response.json()["objects"][0]["result"] == "FITTED"


def test_points_that_are_not_finite_are_dropped_and_counted(
    service: RunningService, frame: SmallFrame
) -> None:
    holes = np.full((5, 3), np.nan, np.float32)
    points = kitti_bin(np.concatenate([frame.points_velo, holes]))
    answer = service.label(frame.fields(points=points)).json()
    assert answer["dropped_points"] == 5
    assert answer["objects"] == service.label(frame.fields()).json()["objects"]


@pytest.mark.parametrize(
    ("prompt", "points", "result", "says"),
    [
        ({"class": "Car", "box": [600, 200, 600, 200]}, None, "BAD_BOX", "no area"),
        ({"class": "Car", "box": [650, 200, 600, 250]}, None, "BAD_BOX", "no area"),
        ({"class": "Car", "box": [1300, 10, 1400, 60]}, None, "BOX_OUTSIDE_IMAGE", "outside the image"),
        ({"class": "Car", "box": [-1e308, -1e308, 1e308, 1e308]}, None, "BAD_BOX", "absurd numbers"),
        ({"class": "Unicorn", "box": [540, 180, 660, 260]}, None, "UNKNOWN_CLASS", "Unicorn"),
        ({"class": "Car", "box": [540, 180, 660, 260]}, 1, "TOO_FEW_POINTS", "(1, at least 2 are needed)"),
        ({"class": "Car", "box": [0, 0, 5, 5]}, None, "TOO_FEW_POINTS", "(0, at least 2 are needed)"),
    ],
    ids=["zero size", "inside out", "outside", "huge", "unknown class", "1 point", "no points"],
)
def test_an_unusable_prompt_has_a_sentence_and_fails_no_other(
    service: RunningService,
    frame: SmallFrame,
    prompt: dict[str, object],
    points: int | None,
    result: str,
    says: str,
) -> None:
    changes = {"prompts": json.dumps([prompt, CAR]).encode()}
    if points is not None:
        changes["points"] = kitti_bin(np.array([[15, 0, -1]] * points, np.float32))
    response = service.label(frame.fields(**changes))
    assert response.status_code == 200
    unusable, car = response.json()["objects"]
    assert unusable["result"] == result
    assert says in unusable["sentence"]
    assert unusable["box"] is None
    assert unusable["kitti"] is None
    assert car["result"] == ("FITTED" if points is None else "TOO_FEW_POINTS")
    text = service.label(frame.fields(**changes), accept="text/plain").text
    assert text.count("\n") == (1 if points is None else 0)


def test_no_prompts_in_the_list_is_no_error(service: RunningService, frame: SmallFrame) -> None:
    response = service.label(frame.fields(prompts=b"[]"))
    assert response.status_code == 200
    assert response.json()["objects"] == []


def test_a_wrong_rig_is_a_warning_in_the_answer(service: RunningService, frame: SmallFrame) -> None:
    assert service.label(frame.fields()).json()["warnings"] == []
    transposed = np.array(CAM_T_VELO)
    transposed[:3, :3] = transposed[:3, :3].T
    response = service.label(frame.fields(calib=calib_json(cam_T_velo=transposed.tolist())))
    assert response.status_code == 200
    (warning,) = response.json()["warnings"]
    assert warning["name"] == "TILTED"
    assert "leans 90 degrees" in warning["sentence"]


def test_server_timing_tells_every_stage(service: RunningService, frame: SmallFrame) -> None:
    header = service.label(frame.fields()).headers["server-timing"]
    stages = dict(stage.split(";dur=") for stage in header.split(", "))
    assert list(stages) == [
        "receive", "queue", "decode", "rig", "ground", "scout", "fit", "polish", "evidence", "confidence",
        "encode", "total",
    ]  # fmt: skip
    durations = {name: float(duration) for name, duration in stages.items()}
    assert all(duration >= 0 for duration in durations.values())
    assert sum(durations.values()) <= 2 * durations["total"]


def test_concurrent_requests_get_their_own_answers(service: RunningService, frame: SmallFrame) -> None:
    names = [f"frame-{number}" for number in range(12)]

    def label(name: str) -> tuple[str, str]:
        answer = service.label(frame.fields(name=name.encode())).json()
        return answer["frame"], json.dumps(answer["objects"])

    alone = [label(name) for name in names]
    with ThreadPoolExecutor(6) as pool:
        together = list(pool.map(label, names))
    assert together == alone
    assert [name for name, _ in together] == names


def test_prompts_are_found_where_none_are_given(service: RunningService, kitti_object_root: Path) -> None:
    training = kitti_object_root / "training"
    stem = next(path.stem for path in sorted((training / "velodyne").glob("*.bin")))
    image = (training / "image_2" / f"{stem}.png").read_bytes()
    points = (training / "velodyne" / f"{stem}.bin").read_bytes()[: 16 * 100_000]
    fields: Fields = {
        "points": (f"{stem}.bin", points),
        "calib": (None, (training / "calib" / f"{stem}.txt").read_bytes()),
        "image": (None, image),
        "options": (None, b'{"detection": {"min_score": 0.4}}'),
    }
    response = service.label(fields)
    answer = LabelAnswer.model_validate_json(response.content)
    detector = Detector.open()
    found = detector.detect(decode_image(image), 0.4).prompts
    assert found
    assert [item.prompt_box_px for item in answer.objects] == [prompt.box_px for prompt in found]
    assert answer.model_digest == detector.digest
    assert "detect;dur=" in response.headers["server-timing"]
    given = service.label(fields | {"prompts": (None, to_json(found).encode())})
    assert given.json()["objects"] == response.json()["objects"]
    assert given.json()["model_digest"] is None


def test_a_real_frame(service: RunningService, kitti_object_root: Path) -> None:
    training = kitti_object_root / "training"
    stem = next(path.stem for path in sorted((training / "velodyne").glob("*.bin")))
    labelled = kitti_label.read_file(training / "label_2" / f"{stem}.txt")
    prompts = kitti_label.prompts_of(labelled)
    image = (training / "image_2" / f"{stem}.png").read_bytes()
    points = training / "velodyne" / f"{stem}.bin"
    calib = training / "calib" / f"{stem}.txt"
    data = points.read_bytes()[: 16 * 100_000]  # as many as this service takes
    response = service.label(
        {
            "points": (points.name, data),
            "calib": (None, calib.read_bytes()),
            "image": (None, image),
            "prompts": (None, to_json(prompts).encode()),
        },
        accept="text/plain",
    )
    frame = Frame(
        stem,
        read_points(points).points[:100_000],
        read_calibration(calib).calibration,
        image_size(image),
        prompts,
    )
    expected = Labeller().label(frame)
    assert len(expected.objects) == len(prompts)
    assert response.text == kitti_label.to_text(kitti_label.objects_of(expected))
