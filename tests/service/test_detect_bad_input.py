from __future__ import annotations

import json
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from service.frames import CAR, P2, Parts, calib_json, calib_text, detect_parts, grey_png, png, png_bomb
from service.running import RunningService
from service.test_bad_input import assert_problem

ANY_INPUT = settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@pytest.fixture(autouse=True)
def still_detects_afterwards(service: RunningService) -> Iterator[None]:
    """Whatever a test sent: the same process of the service finds objects."""
    workers = service.workers("detect")
    yield
    assert service.process.poll() is None
    assert service.detect(detect_parts(grey_png())).status_code == 200
    assert service.workers("detect") == workers


def camera(focal_x: float, focal_y: float = 700.0) -> bytes:
    return json.dumps({"P2": [[focal_x, 0, 600, 0], [0, focal_y, 180, 0], [0, 0, 1, 0]]}).encode()


GREY = grey_png()
NOISE = png(np.random.default_rng(1).integers(0, 256, (100, 300, 3), np.uint8))
SIXTEEN_BITS = png(np.full((100, 300), 40_000, np.uint16))
BAD_PARTS: dict[str, tuple[Parts, str, str]] = {
    "no image": (detect_parts()[-1:], "image", "no field 'image'"),
    "no calib": (detect_parts(GREY)[:1], "calib", "no field 'calib'"),
    "text as image": (detect_parts(b"this is no image"), "image", "no PNG or JPEG"),
    "empty image": (detect_parts(b""), "image", "no PNG or JPEG"),
    "truncated image": (detect_parts(NOISE[: len(NOISE) // 2]), "image", "cannot be decoded"),
    "corrupt image": (detect_parts(NOISE[:200] + bytes(300) + NOISE[500:]), "image", "cannot be decoded"),
    "image of 16 bits": (detect_parts(SIXTEEN_BITS), "image", "mode"),
    "image bomb": (detect_parts(png_bomb(5000)), "image", "5000 x 5000"),
    "image bomb of gigapixels": (detect_parts(png_bomb(50_000)), "image", "50000 x 50000 pixels"),
    "second image is text": (detect_parts(GREY, b"text"), "image[1]", "no PNG or JPEG"),
    "second image is truncated": (detect_parts(GREY, GREY[:-60]), "image[1]", "cannot be decoded"),
    "too many images": (detect_parts(*[GREY] * 5), "image", "comes 5 times"),
    "calib of words": (detect_parts(GREY, calib=calib_text("a b c")), "calib.P2", "'a' is not a number"),
    "calib of NaN": (detect_parts(GREY, calib=calib_text("nan " * 12)), "calib.P2", "not finite"),
    "calib of infinity": (detect_parts(GREY, calib=calib_text("inf " * 12)), "calib.P2", "not finite"),
    "calib of NaN in JSON": (detect_parts(GREY, calib=b'{"P2": [[NaN]]}'), "calib", "NaN"),
    "calib with three numbers": (detect_parts(GREY, calib=calib_text("1 2 3")), "calib.P2", "3 numbers"),
    "calib is empty": (detect_parts(GREY, calib=b""), "calib.P2", "no line P2"),
    "calib is binary": (detect_parts(GREY, calib=GREY), "calib", "not text"),
    "calib singular": (detect_parts(GREY, calib=calib_text("0 " * 12)), "calib.P2", "singular"),
    "calib of another image": (
        detect_parts(GREY, calib=calib_json(image_size=[7, 5])),
        "calib.image_size",
        "the image has (1200, 360)",
    ),
    "focal length of a millimetre": (detect_parts(GREY, calib=camera(0.001)), "calib.P2", "a view of 180"),
    "focal length of a million": (detect_parts(GREY, calib=camera(1e6)), "calib.P2", "a view of 0 degrees"),
    "focal lengths that differ": (detect_parts(GREY, calib=camera(700, 7)), "calib.P2", "700 and 7"),
    "mirrored camera": (detect_parts(GREY, calib=camera(-700)), "calib.P2", "-700"),
    "beyond any number of pixels": (detect_parts(GREY, calib=camera(1e300, 1e300)), "calib.P2", "1e+300"),
    "three calibs for two images": (
        [*detect_parts(GREY, GREY), *[("calib", (None, calib_text()))] * 2],
        "calib",
        "3 calibrations for 2 images",
    ),
    "second calib is wrong": (
        [*detect_parts(GREY, GREY), ("calib", (None, b"P2: 1"))],
        "calib[1].P2",
        "1 numbers",
    ),
    "second camera is absurd": (
        [*detect_parts(GREY, GREY), ("calib", (None, camera(1.0)))],
        "calib[1].P2",
        "a view of",
    ),
    "prompts no JSON": (detect_parts(GREY, prompts=b"[{"), "prompts", "not JSON"),
    "prompts no list": (detect_parts(GREY, prompts=b"{}"), "prompts", "no list"),
    "prompts with NaN": (
        detect_parts(GREY, prompts=b'[{"class": "Car", "box": [1, 2, 3, NaN]}]'),
        "prompts",
        "NaN",
    ),
    "prompt without box": (detect_parts(GREY, prompts=b'[{"class": "Car"}]'), "prompts[0].box", "no 'box'"),
    "too many prompts": (
        detect_parts(GREY, prompts=json.dumps([CAR] * 51).encode()),
        "prompts",
        "51 prompts",
    ),
    "too many prompts of one": (
        detect_parts(GREY, GREY, prompts=json.dumps([[], [CAR] * 51]).encode()),
        "prompts[1]",
        "51 prompts",
    ),
    "prompts of one for two images": (
        detect_parts(GREY, GREY, prompts=json.dumps([CAR]).encode()),
        "prompts",
        "for 2 images",
    ),
    "lists of prompts for one image": (
        detect_parts(GREY, prompts=json.dumps([[CAR], []]).encode()),
        "prompts",
        "2 lists for 1 image.",
    ),
    "wrong prompt of the second image": (
        detect_parts(GREY, GREY, prompts=json.dumps([[CAR], [{"class": "Car", "box": [1]}]]).encode()),
        "prompts[1][0].box",
        "not four finite numbers",
    ),
    "min_score is no number": (detect_parts(GREY, min_score=b"high"), "min_score", "'high'"),
    "min_score is NaN": (detect_parts(GREY, min_score=b"nan"), "min_score", "'nan'"),
    "min_score out of range": (detect_parts(GREY, min_score=b"1.5"), "min_score", "'1.5'"),
    "min_score is binary": (detect_parts(GREY, min_score=b"\xff"), "min_score", "no score"),
    "unknown field": (detect_parts(GREY, points=b"1"), "points", "'points' is unknown"),
}


@pytest.mark.parametrize(("parts", "field", "says"), BAD_PARTS.values(), ids=BAD_PARTS)
def test_a_bad_part_is_named(service: RunningService, parts: Parts, field: str, says: str) -> None:
    assert_problem(service.detect(parts), 422, field, says)


@pytest.mark.parametrize(
    ("headers", "status"),
    [({}, 415), ({"Content-Type": "image/png"}, 415), ({"Content-Type": "multipart/form-data"}, 400)],
)
def test_a_body_that_is_no_form(service: RunningService, headers: dict[str, str], status: int) -> None:
    assert_problem(service.client.post("/detect", content=GREY, headers=headers), status)


def test_a_field_beyond_its_size(service: RunningService) -> None:
    assert_problem(service.detect(detect_parts(GREY, min_score=b"0" * 65)), 413, "min_score", "more than 64")
    assert_problem(service.detect(detect_parts(GREY, calib=bytes(2**21))), 413, "calib", "more than")


@pytest.mark.parametrize("size", [(1, 1), (4000, 1), (1, 4000), (2000, 2000)])
def test_odd_sizes_of_images(service: RunningService, size: tuple[int, int]) -> None:
    width, height = size
    focal = width / 1.5
    calib = json.dumps({"P2": [[focal, 0, width / 2, 0], [0, focal, height / 2, 0], [0, 0, 1, 0]]}).encode()
    response = service.detect(detect_parts(grey_png(50, width, height), calib=calib))
    assert response.status_code == 200, response.text
    assert response.json()["images"][0]["image_size"] == [width, height]


@ANY_INPUT
@given(data=st.data())
def test_any_bytes_in_an_image(service: RunningService, data: st.DataObject) -> None:
    cut = data.draw(st.integers(0, len(NOISE)))
    rest = cut + data.draw(st.integers(0, 9))
    image = NOISE[:cut] + data.draw(st.binary(max_size=40)) + NOISE[rest:]
    response = service.detect(detect_parts(image, calib=json.dumps({"P2": P2}).encode()))
    assert response.status_code in (200, 422), response.text


@ANY_INPUT
@given(
    numbers=st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=12, max_size=12),
    box=st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=4, max_size=4),
)
def test_any_numbers(service: RunningService, numbers: list[float], box: list[float]) -> None:
    p2 = [numbers[:4], numbers[4:8], numbers[8:]]
    prompts = json.dumps([{"class": "Car", "box": box}]).encode()
    for calib in (json.dumps({"P2": p2}).encode(), calib_json()):
        response = service.detect(
            detect_parts(NOISE, calib=calib.replace(b"[1200, 360]", b"[300, 100]"), prompts=prompts)
        )
        assert response.status_code in (200, 422), response.text
        json.loads(response.content, parse_constant=pytest.fail)
