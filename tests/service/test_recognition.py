"""Sweeps by URL, as Xtreme1 asks for them: files of a web server on loopback, boxes in the LiDAR frame."""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Iterator
from typing import Any

import httpx
import numpy as np
import pytest
from numpy.typing import NDArray

from boxlift.formats.calibration import parse_calibration
from boxlift.formats.xtreme1 import boxes_of
from boxlift_service.recognition.answers import RecognisedData, RecognitionAnswer
from model.detector.detector_files import detector_file
from service.file_server import FileServer, answer, file_server
from service.frames import HEIGHT, WIDTH, SmallFrame, calib_json, grey_png
from service.running import RunningService, running_service

Json = dict[str, Any]

AHEAD = [[0.0, -1, 0, 0], [0.0, 0, -1, 0], [1.0, 0, 0, 0], [0.0, 0, 0, 1]]
BESIDE = [[0.0, -1, 0, 0.5], *AHEAD[1:]]
TILTED = [AHEAD[0], [-0.5, 0, -math.sqrt(0.75), 0], [math.sqrt(0.75), 0, -0.5, 0], AHEAD[3]]  # 30 degrees up
INTERNAL = {"fx": 700, "fy": 700, "cx": 600, "cy": 180}
CAR_PX = (540, 180, 660, 260)
PATH = "/pointCloud/recognition"


def pcd(points_velo: NDArray[np.float32]) -> bytes:
    header = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        f"WIDTH {len(points_velo)}\nHEIGHT 1\nPOINTS {len(points_velo)}\nDATA binary\n"
    )
    return header.encode() + points_velo[:, :3].astype("<f4").tobytes()


def camera(cam_T_velo: list[list[float]], **changes: Any) -> Json:
    external = [number for row in cam_T_velo for number in row]
    given = {"camera_internal": INTERNAL, "camera_external": external, "width": WIDTH, "height": HEIGHT}
    return given | changes


@pytest.fixture(scope="module")
def store(frame: SmallFrame) -> Iterator[FileServer]:
    """A bucket with a sweep: cameras 0 and 1 look ahead from half a metre beside each other, 2 is none."""
    with file_server() as running:
        running.files.update(
            {
                "/x1/lidar_point_cloud_0/01.pcd": pcd(frame.points_velo),
                "/x1/camera_image_0/01.png": grey_png(),
                "/x1/camera_image_1/01.png": grey_png(),
                "/x1/camera_image_2/01.png": grey_png(),
                "/x1/camera_config/01.json": json.dumps([camera(AHEAD), camera(BESIDE), None]).encode(),
                "/x1/camera_config/one.json": json.dumps([camera(AHEAD)]).encode(),
                "/x1/camera_config/no_focus.json": json.dumps([camera(AHEAD, camera_internal={})]).encode(),
                "/x1/camera_config/none.json": b"[null]",
                "/x1/camera_config/tilted.json": json.dumps([camera(TILTED)]).encode(),
                "/x1/garbage": b"no such file format",
                "/x1/moved": answer(b"", 302, Location="/x1/lidar_point_cloud_0/01.pcd"),
                "/secret": b"secret",
            }
        )
        yield running


@pytest.fixture(scope="module")
def recogniser(store: FileServer, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningService]:
    detector = detector_file(tmp_path_factory.mktemp("detector") / "own.onnx", [CAR_PX], [0.9], [0])
    with running_service(
        detector=str(detector),
        fetch_from=f"https://elsewhere.example/, {store.url}/x1/",
        fetch_private="true",
        fetch_limit_s="60",
        max_images="3",
    ) as running:
        yield running


def data(store: FileServer, cameras: tuple[int, ...] = (0,), **changes: Any) -> Json:
    given = {
        "id": 7,
        "pointCloudUrl": f"{store.url}/x1/lidar_point_cloud_0/01.pcd?X-Amz-Signature=abc",
        "imageUrls": [f"{store.url}/x1/camera_image_{n}/01.png?X-Amz-Signature=abc" for n in cameras],
        "cameraConfigUrl": f"{store.url}/x1/camera_config/01.json?X-Amz-Signature=abc",
    }
    return {key: value for key, value in (given | changes).items() if value != "-"}


def recognise(service: RunningService, *datas: Any) -> tuple[RecognisedData, ...]:
    response = service.client.post(PATH, json={"datas": datas})
    assert response.status_code == 200, response.text
    return RecognitionAnswer.model_validate_json(response.content).data


def test_the_box_is_that_of_label_in_the_lidar_frame(
    recogniser: RunningService, store: FileServer, frame: SmallFrame
) -> None:
    response = recogniser.client.post(PATH, json={"datas": [data(store)]})
    assert response.status_code == 200
    assert response.headers["content-type"] == "application/json"
    told = response.json()
    assert (told["code"], told["message"], len(told["data"])) == ("OK", "", 1)
    (found,) = told["data"][0].pop("objects")
    assert told["data"][0] == {"id": 7, "code": "OK", "message": ""}

    fields = frame.fields(points=pcd(frame.points_velo), prompts=None, image=grey_png(), name=b"7 camera 0")
    fields["points"] = ("01.pcd", fields["points"][1])
    (label,) = recogniser.label(fields).json()["objects"]
    box = label["box"]
    calibration = parse_calibration(calib_json()).calibration
    back = boxes_of([found], calibration)
    np.testing.assert_allclose(back.center_cam[0], box["center_cam"], atol=1e-4)
    assert [found["dx"], found["dy"], found["dz"]] == pytest.approx(
        [box["length_m"], box["width_m"], box["height_m"]], abs=1e-4
    )
    assert math.remainder(back.rotation_y[0] - box["rotation_y"], 2 * math.pi) == pytest.approx(0, abs=1e-4)
    assert (found["label"], found["confidence"]) == ("CAR", label["score"])
    assert 14 < found["x"] < 19  # the car was built 15 to 19 m ahead, on the road 1.7 m below the LiDAR
    assert abs(found["y"]) < 0.5
    assert found["z"] - found["dz"] / 2 == pytest.approx(-1.7, abs=0.3)


def test_a_car_in_two_images_is_told_once(recogniser: RunningService, store: FileServer) -> None:
    (first,) = recognise(recogniser, data(store, (0,)))
    (second,) = recognise(recogniser, data(store, (1,)))
    (both,) = recognise(recogniser, data(store, (0, 1)))
    assert [len(one.objects) for one in (first, second, both)] == [1, 1, 1]
    assert both.objects[0] == max(first.objects + second.objects, key=lambda found: found.confidence)


def test_the_folder_says_which_camera_an_image_is_of(recogniser: RunningService, store: FileServer) -> None:
    """Else its place in the list does, as where all images lie in one folder."""
    first, second = recognise(recogniser, data(store, (0,)), data(store, (1,)))
    assert first != second
    store.files.update(
        {"/x1/all/1.png": grey_png(), "/x1/image1/1.png": grey_png(), "/x1/image_1/1.png": grey_png()}
    )
    for folder, same in (("all", first), ("image1", second), ("image_1", second)):
        urls = [f"{store.url}/x1/{folder}/1.png"]
        assert recognise(recogniser, data(store, imageUrls=urls)) == (same,)
    swapped = [f"{store.url}/x1/camera_image_{camera}/01.png" for camera in (1, 0)]
    assert recognise(recogniser, data(store, imageUrls=swapped)) == recognise(recogniser, data(store, (0, 1)))


def test_images_of_cameras_without_parameters_are_skipped(
    recogniser: RunningService, store: FileServer
) -> None:
    before = len(store.asked)
    (found,) = recognise(recogniser, data(store, (0, 2)))
    assert (found.code, len(found.objects)) == ("OK", 1)
    assert not any("camera_image_2" in path for path in store.paths[before:])


def test_doubts_about_the_cameras_are_told(recogniser: RunningService, store: FileServer) -> None:
    (found,) = recognise(recogniser, data(store, cameraConfigUrl=f"{store.url}/x1/camera_config/tilted.json"))
    assert found.code == "OK"
    assert found.message.startswith("Camera 0: The ground leans 30 degrees")


def test_one_fails_and_the_others_do_not(recogniser: RunningService, store: FileServer) -> None:
    secret = f"{store.url}/x1/../secret"
    answers = recognise(
        recogniser, data(store, id="a"), data(store, id=2, pointCloudUrl=secret), data(store, id=3)
    )
    assert [(found.id, found.code, len(found.objects)) for found in answers] == [
        ("a", "OK", 1),
        (2, "FETCH_REFUSED", 0),
        (3, "OK", 1),
    ]
    assert "pointCloudUrl" in answers[1].message


@pytest.mark.parametrize(
    ("changes", "code", "says"),
    [
        ({"id": "-"}, "INVALID_FIELD", "id: None"),
        ({"id": True}, "INVALID_FIELD", "id: True"),
        ({"id": "a\nb"}, "INVALID_FIELD", "id: 'a\\nb'"),
        ({"pointCloudUrl": "-"}, "INVALID_FIELD", "pointCloudUrl: None"),
        ({"cameraConfigUrl": None}, "INVALID_FIELD", "cameraConfigUrl: None"),
        ({"imageUrls": "-"}, "INVALID_FIELD", "imageUrls: there is no image"),
        ({"imageUrls": "{url}/x1/camera_image_0/01.png"}, "INVALID_FIELD", "imageUrls"),
        ({"imageUrls": [1]}, "INVALID_FIELD", "imageUrls: [1]"),
        ({"imageUrls": ["{url}/x1/camera_image_0/01.png"] * 4}, "INVALID_FIELD", "at most 3"),
        ({"pointCloudUrl": "{url}/secret"}, "FETCH_REFUSED", "pointCloudUrl"),
        ({"cameraConfigUrl": "http://169.254.169.254/x1/"}, "FETCH_REFUSED", "cameraConfigUrl"),
        ({"imageUrls": ["{url}/x1/camera_image_0/01.png", "file:///a"]}, "FETCH_REFUSED", "imageUrls[1]"),
        ({"pointCloudUrl": "{url}/x1/moved"}, "FETCH_FAILED", "redirect"),
        ({"pointCloudUrl": "{url}/x1/absent?key=hidden"}, "FETCH_FAILED", "404"),
        ({"pointCloudUrl": "{url}/x1/garbage"}, "INVALID_FIELD", "pointCloudUrl: the data is text"),
        ({"imageUrls": ["{url}/x1/garbage"]}, "INVALID_FIELD", "imageUrls[0]"),
        ({"cameraConfigUrl": "{url}/x1/garbage"}, "INVALID_FIELD", "cameraConfigUrl: the data is not JSON"),
        ({"cameraConfigUrl": "{url}/x1/camera_config/no_focus.json"}, "INVALID_FIELD",
         "cameraConfigUrl[0].camera_internal.fx"),
        ({"cameraConfigUrl": "{url}/x1/camera_config/none.json"}, "INVALID_FIELD", "none of the cameras [0]"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_beside_the_id(
    recogniser: RunningService, store: FileServer, changes: Json, code: str, says: str
) -> None:
    here = json.loads(json.dumps(changes).replace("{url}", store.url))
    (found,) = recognise(recogniser, data(store, **here))
    assert (found.code, found.objects) == (code, ())
    assert says in found.message
    assert "hidden" not in found.message
    assert found.id == (7 if "id" not in changes else None)


@pytest.mark.parametrize("given", [None, 7, "text", [], {}])
def test_data_that_are_none(recogniser: RunningService, store: FileServer, given: Any) -> None:
    bad, good = recognise(recogniser, given, data(store))
    assert (bad.id, bad.code) == (None, "INVALID_FIELD")
    assert good.code == "OK"


def test_clients_that_leave_give_their_places_back(recogniser: RunningService, store: FileServer) -> None:
    """Two sweeps are fetched at a time, from a server that never answers, for clients that do not wait."""
    released = threading.Event()
    store.files["/x1/stalls"] = lambda _: void(released.wait(60))
    stalling = {"datas": [data(store, pointCloudUrl=f"{store.url}/x1/stalls")]}
    try:
        for _ in range(3):
            with pytest.raises(httpx.ReadTimeout):
                recogniser.client.post(PATH, json=stalling, timeout=1)
        response = recogniser.client.post(PATH, json={"datas": [data(store)]}, timeout=20)
    finally:
        released.set()
    assert response.json()["data"][0]["code"] == "OK"


def void(_: object) -> None:
    """Whatever it was, nobody wants it."""


def test_no_data(recogniser: RunningService) -> None:
    assert recognise(recogniser) == ()


@pytest.mark.parametrize(
    ("body", "content_type", "status", "says"),
    [
        (b"{", "application/json", 400, "not JSON"),
        (b"\xff", "application/json", 400, "UTF-8"),
        (b'{"datas": [NaN]}', "application/json", 400, "NaN"),
        (b"[" * 100_000, "application/json", 400, "nested"),
        (b"[]", "application/json", 422, "None"),
        (b"{}", "application/json", 422, "None"),
        (b'{"datas": {}}', "application/json", 422, "{}"),
        (b'{"datas": [1, 2, 3, 4]}', "application/json", 422, "at most 3"),
        (b"{}" + b" " * 2**18, "application/json", 413, "262144 bytes"),
        (b"{}", "text/plain", 415, "text/plain"),
        (b"{}", "", 415, "no Content-Type"),
    ],
)
def test_requests_that_are_none(
    recogniser: RunningService, body: bytes, content_type: str, status: int, says: str
) -> None:
    headers = {"Content-Type": content_type} if content_type else {}
    response = recogniser.client.post(PATH, content=body, headers=headers)
    assert response.status_code == status
    assert response.headers["content-type"] == "application/problem+json"
    assert says in response.json()["detail"]


def test_as_xtreme1_sends_it(recogniser: RunningService, store: FileServer) -> None:
    """With the charset that its HTTP library adds, keys that a later version may add, and under /v1."""
    response = recogniser.client.post(
        "/v1" + PATH,
        content=json.dumps({"datas": [data(store, extra=None)], "more": 1}),
        headers={"Content-Type": "application/json;charset=UTF-8"},
    )
    assert response.json()["data"][0]["code"] == "OK"
    stages = [stage.partition(";")[0] for stage in response.headers["server-timing"].split(", ")]
    assert {"receive", "fetch", "detect", "decode", "fit", "total"} <= set(stages)


def test_results_are_counted(recogniser: RunningService, store: FileServer) -> None:
    def fitted() -> float:
        name = f'boxlift_results_total{{result="FITTED",route="{PATH}"}}'
        lines = recogniser.client.get("/metrics").text.splitlines()
        return sum(float(line.split()[-1]) for line in lines if line.startswith(name))

    before = fitted()
    recognise(recogniser, data(store, (0, 1)))
    assert fitted() == before + 2


def test_documented(recogniser: RunningService) -> None:
    operation = recogniser.client.get("/openapi.json").json()["paths"][PATH]["post"]
    assert set(operation["responses"]) >= {"200", "400", "408", "413", "415", "422"}
    item = operation["requestBody"]["content"]["application/json"]["schema"]["properties"]["datas"]["items"]
    assert item["required"] == ["id", "pointCloudUrl", "imageUrls", "cameraConfigUrl"]
