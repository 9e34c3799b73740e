"""Requests that are nearly right: files, numbers, settings or headers of them are damaged."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from random import Random
from typing import Any, Literal, get_args, get_origin

import annotated_types
import msgpack
import numpy as np
from pydantic import BaseModel

from boxlift.settings import LabellerSettings
from fuzz import seeds
from fuzz.bodies import BOUNDARY
from fuzz.decoders import decoders
from fuzz.mutator import damaged
from service.frames import CAM_T_VELO, CAR, HEIGHT, P2, WIDTH, grey_png, mask_png, small_frame

LABEL, DETECT, BATCH = "POST /label", "POST /detect", "POST /label:batch"
RECOGNITION = "POST /pointCloud/recognition"

_FORM = "multipart/form-data; boundary=" + BOUNDARY.decode()
_ACCEPT = (
    *("application/json", "text/plain", "application/x-ndjson", "*/*", "text/html", "application/json;q=0"),
    *("a/b;q=x", ";", ",,,", "application/*;q=0.1, text/plain;q=1e400", "*/*;" * 500),
)
_TIMEOUTS = ("0.001", "0", "-1", "nan", "1e400", "abc", "5", "1_0", "3;4", "9" * 400)
_WILD = (0, 1, -1, 0.5, 1e-300, -1e300, 1e300, 65_535, 1e8, -1e8, 1e5, 2**31, 2**63, 1e-9, 3.14159)
# They only say how long to compute.
_WORK_SETTINGS = {"iterations", "adam_steps", "grid_steps", "beam_width", "levels", "sample_count"}
Json = Any


@dataclass(frozen=True)
class Asked:
    """A request, and files that it will have fetched, by path."""

    path: str
    headers: dict[str, str]
    body: bytes
    files: dict[str, bytes] = field(default_factory=dict)


def damaged_request(route: str, seed: int, store_url: str) -> Asked:
    """A request to one of the four routes that compute; the same for the same seed and store."""
    random = Random(seed)
    makers: dict[str, Callable[[Random], tuple[str, bytes, dict[str, bytes]]]] = {
        LABEL: _label,
        DETECT: _detect,
        BATCH: _batch,
        RECOGNITION: lambda random: _recognition(random, store_url),
    }
    content_type, body, files = makers[route](random)
    headers = {"Content-Type": content_type}
    if random.random() < 0.1:
        headers["Accept"] = random.choice(_ACCEPT)
    if random.random() < 0.05:
        headers["X-Request-Timeout"] = random.choice(_TIMEOUTS)
    if random.random() < 0.03:
        headers["Content-Type"] = random.choice(
            ("", "text/plain", content_type + "x", content_type[:-3], ";")
        )
    version = random.choice(("", "/v1"))
    return Asked(version + route.removeprefix("POST "), headers, body, files)


def _label(random: Random) -> tuple[str, bytes, dict[str, bytes]]:
    fields = _frame_fields(random)
    if random.random() < 0.3:
        packed: bytes = msgpack.packb(fields)
        if random.random() < 0.2:
            packed = decoders()["msgpack"].damaged(packed, random.getrandbits(32))
        return "application/msgpack", packed, {}
    return _FORM, _form(list(fields.items()), random), {}


def _detect(random: Random) -> tuple[str, bytes, dict[str, bytes]]:
    parts: list[tuple[str, bytes]] = [
        ("image", _image(random)) for _ in range(random.choice((1, 1, 1, 2, 3)))
    ]
    parts.append(("calib", _calib(random, "calib-camera", random.random() < 0.1)))
    if random.random() < 0.5:
        lists = [_wild([CAR], random) for _ in parts[:-1]]
        parts.append(("prompts", _maybe_damaged(json.dumps(lists).encode(), "prompt-lists", random)))
    if random.random() < 0.2:
        parts.append(("min_score", random.choice((b"0.3", b"nan", b"1e400", b"-0", b"", b"1" * 60, b"\xff"))))
    return _FORM, _form(parts, random), {}


def _batch(random: Random) -> tuple[str, bytes, dict[str, bytes]]:
    maps: list[bytes] = []
    for index in range(random.choice((0, 1, 2, 3))):
        fields = _frame_fields(random)
        if random.random() < 0.9:
            fields["name"] = f"frame {index * random.choice((0, 1, 1))}".encode()
        maps.append(msgpack.packb(fields))
    body = b"".join(maps)
    if random.random() < 0.2:
        body = decoders()["msgpack"].damaged(body, random.getrandbits(32))
    return "application/msgpack", body, {}


def _recognition(random: Random, store_url: str) -> tuple[str, bytes, dict[str, bytes]]:
    camera: Json = {
        "camera_internal": {"fx": 700, "fy": 700, "cx": 600, "cy": 180},
        "camera_external": np.array(CAM_T_VELO, np.float64).ravel().tolist(),
    }
    config = json.dumps(_wild([camera] * random.choice((1, 2)), random)).encode()
    files = {
        "/points": _points(random),
        "/camera_image_0/0": _image(random),
        "/config": _maybe_damaged(config, "camera-config", random),
    }
    urls = {name: f"{store_url}{name}?{random.getrandbits(16)}" for name in files}
    sweep: dict[str, Json] = {
        "id": random.choice((1, "a", 2**63 - 1)),
        "pointCloudUrl": urls["/points"],
        "imageUrls": [urls["/camera_image_0/0"]] * random.choice((1, 1, 2)),
        "cameraConfigUrl": urls["/config"],
    }
    if random.random() < 0.3:
        key = random.choice(tuple(sweep))
        sweep[key] = random.choice(
            (None, 1e400, True, [], {}, "", "file:///etc/passwd", store_url + "/none", "\ud800")
        )
    body = json.dumps({"datas": [sweep] * random.choice((0, 1, 1, 2))}).encode()
    return "application/json", _maybe_damaged(body, "prompts", random), files


def _frame_fields(random: Random) -> dict[str, bytes]:
    has_image = random.random() < 0.25
    fields = {"points": _points(random)}
    fields["calib"] = _calib(random, "calib-json", random.random() < (0.1 if has_image else 0.95))
    if random.random() < (0.6 if has_image else 0.95):
        prompts = json.dumps(_wild([CAR] * random.choice((0, 1, 1, 2)), random)).encode()
        fields["prompts"] = _maybe_damaged(prompts, "prompts", random)
    if has_image:
        fields["image"] = _image(random)
    if random.random() < 0.2:
        masks = mask_png(540, 180, 660, 260) if random.random() < 0.7 else random.choice(seeds.masks())
        fields["masks"] = _maybe_damaged(masks, "masks", random)
    if random.random() < 0.5:
        options = json.dumps(_options(random)).encode()
        fields["options"] = _maybe_damaged(options, "options", random, 0.2)
    if random.random() < 0.2:
        fields["name"] = random.choice((b"a", b"", b"\x00", b"\xff", "\u202e".encode(), b"x" * 201))
    if random.random() < 0.05:
        fields.pop(random.choice(tuple(fields)))
    if random.random() < 0.03:
        fields[random.choice(("point", "points_filename", "\x1b[31m"))] = b"a.bin"
    return fields


def _points(random: Random) -> bytes:
    if random.random() < 0.3:
        name = random.choice(("bin", "npy", "npz", "pcd-ascii", "pcd-compressed", "ply-big"))
        return _maybe_damaged(random.choice(decoders()[name].seeds), name, random)
    points = small_frame().points_velo.copy()
    match random.randrange(8):
        case 0:
            points[:] = points[random.randrange(len(points))]
        case 1:
            points[:, random.randrange(3)] = random.choice((0.0, 1e5, -1e5, 1e-30))
        case 2:
            points *= random.choice((1e-3, 1e3, -1))
        case 3:
            points = points[: random.choice((1, 2, 3, 5, 20))]
        case 4:
            points[random.randrange(len(points)) :, 0] = np.nan
    stream = io.BytesIO()
    np.save(stream, points)
    return _maybe_damaged(stream.getvalue(), "npy", random, 0.05)


def _calib(random: Random, decoder: str, with_size: bool) -> bytes:
    if random.random() < 0.1:
        return _maybe_damaged(random.choice(seeds.calibration_text()), "calib-text", random)
    calib: Json = {"P2": P2, "cam_T_velo": CAM_T_VELO, "image_size": [WIDTH, HEIGHT]}
    if not with_size:
        del calib["image_size"]
    return _maybe_damaged(json.dumps(_wild(calib, random, 0.01)).encode(), decoder, random, 0.06)


def _image(random: Random) -> bytes:
    if random.random() < 0.5:
        return _maybe_damaged(_grey_image(), "png", random, 0.2)
    name = random.choice(("png", "jpeg"))
    return _maybe_damaged(random.choice(decoders()[name].seeds), name, random)


@cache
def _grey_image() -> bytes:
    return grey_png()


def _options(random: Random) -> dict[str, Json]:
    """Settings within their ranges, at the ends of these above all."""
    options: dict[str, Json] = {"preset": random.choice(("paper", "release", "accurate", "accurate"))}
    groups = {
        name: group
        for name, info in LabellerSettings.model_fields.items()
        for group in (info.annotation, *get_args(info.annotation))
        if isinstance(group, type) and issubclass(group, BaseModel)
    }
    for name in random.sample(sorted(groups), random.choice((0, 1, 2))):
        settings = groups[name].model_fields
        chosen = random.sample(sorted(settings.keys() - _WORK_SETTINGS), 1)
        options[name] = {key: _setting(settings[key], random) for key in chosen}
    return options


def _setting(info: Any, random: Random) -> Json:
    if get_origin(info.annotation) is Literal:
        return random.choice(get_args(info.annotation))
    if info.annotation is bool:
        return random.random() < 0.5
    bounds: list[Any] = info.metadata
    ends: list[Json] = [1, 0.5]
    for bound in bounds:
        match bound:
            case annotated_types.Ge():
                ends.append(bound.ge)
            case annotated_types.Le():
                ends.append(bound.le)
            case annotated_types.Gt():
                ends.append(float(str(bound.gt)) + 1e-6)
    return random.choice(ends)


def _wild(value: Json, random: Random, share: float = 0.03) -> Json:
    """The value with some of its numbers wild, or nearly what they were."""
    match value:
        case dict():
            return {key: _wild(item, random, share) for key, item in value.items()}
        case list():
            return [_wild(item, random, share) for item in value]
        case int() | float() if random.random() < share:
            return random.choice((random.choice(_WILD), value * random.uniform(0.9, 1.1), -value))
        case _:
            return value


def _maybe_damaged(data: bytes, decoder: str, random: Random, share: float = 0.15) -> bytes:
    seed = random.getrandbits(32)
    return decoders()[decoder].damaged(data, seed) if random.random() < share else data


def _form(parts: list[tuple[str, bytes]], random: Random) -> bytes:
    body = b""
    for name, data in parts:
        file = '; filename="a.bin"' if random.random() < 0.5 else ""
        head = f'Content-Disposition: form-data; name="{name}"{file}\r\n\r\n'.encode()
        body += b"--" + BOUNDARY + b"\r\n" + head + data + b"\r\n"
    body += b"--" + BOUNDARY + b"--\r\n"
    if random.random() < 0.15:
        return damaged(body, random, decoders()["form"].words, ())
    return body
