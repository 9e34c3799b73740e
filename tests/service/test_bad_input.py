from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from urllib.parse import urlsplit

import httpx
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from service.frames import (
    CAR,
    HEIGHT,
    WIDTH,
    SmallFrame,
    calib_json,
    calib_text,
    kitti_bin,
    mask_png,
    png,
    png_bomb,
)
from service.running import RunningService

MULTIPART = {"Content-Type": "multipart/form-data; boundary=line"}
ANY_INPUT = settings(
    max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@pytest.fixture(autouse=True)
def still_labels_afterwards(service: RunningService, frame: SmallFrame) -> Iterator[None]:
    """Whatever a test sent: the service lives and labels."""
    yield
    assert service.process.poll() is None
    assert service.client.get("/healthz").status_code == 200
    assert service.label(frame.fields()).json()["objects"][0]["result"] == "FITTED"


def assert_problem(response: httpx.Response, status: int, field: str | None = None, says: str = "") -> None:
    assert response.headers["content-type"] == "application/problem+json"
    problem = json.loads(response.content, parse_constant=pytest.fail)
    assert response.status_code == problem["status"] == status, problem
    assert problem.get("field") == field, problem
    assert says in problem["problem"], problem
    assert problem["detail"] == f"{problem['problem']} {problem['remedy']}"
    assert problem["instance"] == response.request.url.path
    assert problem["type"].startswith("urn:boxlift:problem:")
    assert problem["title"]


NAN_POINTS = np.full((50, 3), np.nan, np.float32)
BAD_FIELDS: dict[str, tuple[dict[str, bytes | None], str, str]] = {
    "truncated .bin": ({"points": bytes(16 * 100 - 3)}, "points", "truncated"),
    "all points NaN": ({"points": kitti_bin(NAN_POINTS)}, "points", "none of the 50 points is finite"),
    "no points": ({"points": b""}, "points", "0 bytes"),
    "too many points": ({"points": bytes(16 * 100_001)}, "points", "100001 points"),
    "text as points": ({"points": b"hello, here are my points"}, "points", "text"),
    "points field missing": ({"points": None}, "points", "no field 'points'"),
    "calib field missing": ({"calib": None}, "calib", "no field 'calib'"),
    "singular calib": ({"calib": calib_text("0 0 0 0 0 0 0 0 0 0 0 0")}, "calib.P2", "singular"),
    "calib of words": ({"calib": calib_text("a 0 0 0 0 0 0 0 0 0 0 0")}, "calib.P2", "'a' is not a number"),
    "calib of NaN": ({"calib": calib_text("nan 0 0 0 0 0 0 0 0 0 0 0")}, "calib.P2", "not finite"),
    "calib with a LiDAR far away": (
        {"calib": calib_json(cam_T_velo=[[0, -1, 0, 1e150], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])},
        "calib.cam_T_velo",
        "1e+150",
    ),
    "calib mirrored": (
        {"calib": calib_json(cam_T_velo=[[0, 1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])},
        "calib.cam_T_velo",
        "no rigid transform",
    ),
    "calib without P2": ({"calib": b"P0: 1 2 3\n"}, "calib.P2", "no line P2"),
    "calib of NaN in JSON": ({"calib": b'{"P2": [[NaN]]}'}, "calib", "NaN"),
    "calib no JSON": ({"calib": b'{"P2": '}, "calib", "not JSON"),
    "calib is binary": ({"calib": b"\xff\xfe\x00"}, "calib", "not text"),
    "calib with unknown key": ({"calib": calib_json(P3=1)}, "calib.P3", "unknown"),
    "calib without image size": ({"calib": calib_text()}, "calib.image_size", "how large"),
    "calib and image disagree": (
        {"image": png(np.zeros((5, 7), np.uint8))},
        "calib.image_size",
        "the image has (7, 5)",
    ),
    "text file as image": ({"image": b"this is no image"}, "image", "no PNG or JPEG"),
    "image bomb": ({"image": png_bomb(5000)}, "image", "5000 x 5000"),
    "image bomb of gigapixels": ({"image": png_bomb(50_000)}, "image", "50000 x 50000 pixels"),
    "mask bomb": ({"masks": png_bomb(5000)}, "masks", "5000 x 5000"),
    "masks of the wrong size": ({"masks": mask_png(0, 0, 9, 9, size=(90, 80))}, "masks", "90 x 80"),
    "masks of three channels": ({"masks": png(np.zeros((9, 9, 3), np.uint8))}, "masks", "RGB"),
    "masks are text": ({"masks": b"0 0 0 1 1"}, "masks", "no PNG or JPEG"),
    "truncated masks": ({"masks": mask_png(0, 0, 500, 300)[:-30]}, "masks", "cannot be decoded"),
    "prompts no JSON": ({"prompts": b"[{"}, "prompts", "not JSON"),
    "prompts no list": ({"prompts": b'{"class": "Car"}'}, "prompts", "no list"),
    "prompts with NaN": ({"prompts": b'[{"class": "Car", "box": [1, 2, 3, NaN]}]'}, "prompts", "NaN"),
    "prompts beyond float": (
        {"prompts": b'[{"class": "Car", "box": [1, 2, 3, 1e999]}]'},
        "prompts[0].box",
        "",
    ),
    "prompt without box": ({"prompts": b'[{"class": "Car"}]'}, "prompts[0].box", "no 'box'"),
    "prompt with half a surrogate": (
        {"prompts": rb'[{"class": "\ud800", "box": [1, 2, 3, 4]}]'},
        "prompts[0].class",
        "no class name",
    ),
    "too many prompts": ({"prompts": json.dumps([CAR] * 51).encode()}, "prompts", "51 prompts"),
    "options no JSON": ({"options": b"paper"}, "options", "not JSON"),
    "options no object": ({"options": b"[1]"}, "options", "no object"),
    "options: unknown preset": ({"options": b'{"preset": "best"}'}, "options.preset", "'best'"),
    "options: preset no name": ({"options": b'{"preset": {"a": 1}}'}, "options.preset", "no preset"),
    "options: unknown setting": ({"options": b'{"fit": {"speed": 9}}'}, "options.fit.speed", "9"),
    "options: out of range": ({"options": b'{"fit": {"grid_steps": -1}}'}, "options.fit.grid_steps", "-1"),
    "options: billions of bins": (
        {"options": b'{"heading": {"bin_rad": 1e-9}}'},
        "options.heading.bin_rad",
        "",
    ),
    "options: half a surrogate": ({"options": rb'{"\ud800": "\ud800"}'}, "options", "ud800"),
    "name is empty": ({"name": b""}, "name", "''"),
    "name is no UTF-8": ({"name": b"\xff"}, "name", "xff"),
    "name is too long": ({"name": b"n" * 201}, "name", "nnn"),
    "name has a line break": ({"name": b"a\nb"}, "name", "no name"),
    "unknown field": ({"lidar": b"1"}, "lidar", "'lidar' is unknown"),
    "unknown field with a bad name": ({"\U0001f600": b"1"}, "\U0001f600", "unknown"),
}


@pytest.mark.parametrize(("changes", "field", "says"), BAD_FIELDS.values(), ids=BAD_FIELDS)
def test_a_bad_field_is_named(
    service: RunningService,
    frame: SmallFrame,
    changes: dict[str, bytes | None],
    field: str,
    says: str,
) -> None:
    assert_problem(service.label(frame.fields(**changes)), 422, field, says)


def test_a_field_that_comes_twice(service: RunningService, frame: SmallFrame) -> None:
    fields = list(frame.fields().items())
    response = service.client.post("/label", files=[*fields, fields[1]])
    assert_problem(response, 422, "calib", "twice")


@pytest.mark.parametrize("field", ["calib", "prompts", "options", "name"])
def test_a_text_field_beyond_its_size(service: RunningService, frame: SmallFrame, field: str) -> None:
    assert_problem(service.label(frame.fields(**{field: bytes(5_000_000)})), 413, field, "more than")


def test_without_prompts_an_image_is_needed(service: RunningService, frame: SmallFrame) -> None:
    assert_problem(service.label(frame.fields(prompts=None)), 422, "image", "without prompts")
    masks = frame.fields(prompts=None, masks=mask_png(0, 0, 9, 9), image=png(np.zeros((9, 9, 3), np.uint8)))
    assert_problem(service.label(masks), 422, "masks", "there are none")
    broken = frame.fields(prompts=None, image=png(np.zeros((HEIGHT, WIDTH, 3), np.uint8))[:-90])
    assert_problem(service.label(broken), 422, "image", "cannot be decoded")


@pytest.mark.parametrize("accept", ["image/png", "application/json;q=0", "application/xml, text/html"])
def test_an_answer_that_the_client_does_not_accept(
    service: RunningService, frame: SmallFrame, accept: str
) -> None:
    assert_problem(service.label(frame.fields(), accept=accept), 406, None, accept.split(",")[0])


@pytest.mark.parametrize(
    "headers",
    [{}, {"Content-Type": "application/json"}, {"Content-Type": "application/x-www-form-urlencoded"}],
    ids=["none", "json", "urlencoded"],
)
def test_a_body_that_is_no_form(service: RunningService, headers: dict[str, str]) -> None:
    assert_problem(service.client.post("/label", content=b"{}", headers=headers), 415, None, "Content-Type")


PART = b'--line\r\nContent-Disposition: form-data; name="calib"\r\n\r\nP2: 1'


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"hello",
        PART,
        PART + b"\r\n--line\r\n",
        b"--line\r\n\r\nno headers\r\n--line--\r\n",
        b"--line\r\nContent-Disposition: form-data\r\n\r\nno name\r\n--line--\r\n",
        b"--line\r\n" + b"A: b\r\n" * 50 + b"\r\n\r\n--line--\r\n",
        b"--line\r\nA: " + b"b" * 100_000 + b"\r\n\r\n\r\n--line--\r\n",
    ],
    ids=["empty", "no boundary", "ends early", "no last part", "no headers", "no name", "headers", "header"],
)
def test_a_form_that_is_malformed(service: RunningService, body: bytes) -> None:
    assert_problem(service.client.post("/label", content=body, headers=MULTIPART), 400)


@pytest.mark.parametrize(
    "content_type", ["multipart/form-data", f"multipart/form-data; boundary={'x' * 999}"]
)
def test_a_boundary_that_cannot_be_used(service: RunningService, content_type: str) -> None:
    response = service.client.post("/label", content=PART, headers={"Content-Type": content_type})
    assert_problem(response, 400, None, "boundary")


POINTS_PART = b'--line\r\nContent-Disposition: form-data; name="points"; filename="a.bin"\r\n\r\n'
ANNOUNCED = {"Content-Length": str(len(POINTS_PART) + 2**30)}


def one_gigabyte() -> Iterator[bytes]:
    yield POINTS_PART
    mebibyte = bytes(2**20)
    for _ in range(1024):
        yield mebibyte


@pytest.mark.parametrize("headers", [{}, ANNOUNCED], ids=["chunked", "announced"])
def test_a_body_of_a_gigabyte(service: RunningService, headers: dict[str, str]) -> None:
    response = service.client.post("/label", content=one_gigabyte(), headers={**MULTIPART, **headers})
    assert_problem(response, 413, None, "The body has")
    assert response.headers["connection"] == "close"


def raw_request(service: RunningService, request: bytes) -> bytes:
    """What the service says to these bytes, as far as it says it before more is sent."""
    address = urlsplit(service.url)
    assert address.hostname is not None
    with socket.create_connection((address.hostname, address.port or 0), timeout=20) as connection:
        connection.sendall(request)
        return connection.recv(65_536)


def test_a_gigabyte_that_is_announced_is_refused_before_it_is_sent(service: RunningService) -> None:
    head = (
        b"POST /label HTTP/1.1\r\nHost: localhost\r\nContent-Type: multipart/form-data; boundary=line\r\n"
        b"Content-Length: 1073741824\r\nExpect: 100-continue\r\n\r\n"
    )
    assert raw_request(service, head).startswith(b"HTTP/1.1 413 ")


def test_an_unknown_field_is_refused_before_the_rest_is_sent(service: RunningService) -> None:
    head = (
        b"POST /label HTTP/1.1\r\nHost: localhost\r\nContent-Type: multipart/form-data; boundary=line\r\n"
        b"Content-Length: 1000000\r\n\r\n"
        b'--line\r\nContent-Disposition: form-data; name="pionts"\r\n\r\n'
    )
    assert raw_request(service, head).startswith(b"HTTP/1.1 422 ")


def test_a_client_that_vanishes_while_it_sends(service: RunningService) -> None:
    head = b"POST /label HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000000\r\n"
    address = urlsplit(service.url)
    assert address.hostname is not None
    for _ in range(5):
        with socket.create_connection((address.hostname, address.port or 0), timeout=20) as connection:
            connection.sendall(head + b"Content-Type: multipart/form-data; boundary=line\r\n\r\n" + PART)


@pytest.mark.parametrize("field", ["points", "calib", "prompts", "options", "image", "masks", "name"])
@ANY_INPUT
@given(data=st.data())
def test_any_bytes_in_a_field(
    service: RunningService, frame: SmallFrame, field: str, data: st.DataObject
) -> None:
    genuine = {
        "points": frame.fields()["points"][1][: 16 * 40],
        "calib": calib_json(),
        "prompts": json.dumps([CAR]).encode(),
        "options": b'{"preset": "release", "fit": {"grid_steps": 3}}',
        "image": png(np.zeros((9, 9), np.uint8)),
        "masks": mask_png(0, 0, 9, 9, size=(20, 20)),
        "name": b"000123",
    }[field]
    cut = data.draw(st.integers(0, len(genuine)))
    content = (
        genuine[:cut] + data.draw(st.binary(max_size=40)) + genuine[cut + data.draw(st.integers(0, 9)) :]
    )
    response = service.label(frame.fields(**{field: content}))
    if response.status_code == 200:
        json.loads(response.content, parse_constant=pytest.fail)
    else:
        problem = response.json()
        assert response.status_code == 422, problem
        assert problem["field"].partition(".")[0].partition("[")[0] in (field, "calib", "points"), problem


@ANY_INPUT
@given(body=st.binary(max_size=200), cut=st.integers(0, 400))
def test_any_bytes_in_a_form(service: RunningService, frame: SmallFrame, body: bytes, cut: int) -> None:
    form = b"".join(
        b'--line\r\nContent-Disposition: form-data; name="%b"\r\n\r\n%b\r\n' % (name.encode(), data[:160])
        for name, (_, data) in frame.fields().items()
    )
    response = service.client.post("/label", content=form[:cut] + body + form[cut:], headers=MULTIPART)
    assert response.status_code in (400, 413, 422)
    assert response.headers["content-type"] == "application/problem+json"
