"""Requests made beforehand: the bytes of POST /label and POST /detect for a few frames."""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count, cycle, islice
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx

from boxlift.datasets.generated import generate
from boxlift.datasets.source import load_prompts, open_source
from boxlift.errors import DatasetError
from boxlift.frame import Frame
from boxlift.settings import DEFAULT_PRESET, preset
from boxlift_client.detect_request import parts_of_image
from boxlift_client.label_request import form_of_frame

OBJECTS = 5

LABEL = "/label, prompts given"
FIND = "/label, prompts found"
DETECT = "/detect"

# Shares of the mix: an annotation tool sends prompts, a job over drives sends none.
MIX: Mapping[str, float] = {LABEL: 0.4, FIND: 0.2, DETECT: 0.4}


@dataclass(frozen=True)
class Prepared:
    """The bytes of a request, and what it is counted as."""

    kind: str
    data: bytes


def frames(folder: Path | None, how_many: int) -> list[Frame]:
    """Frames with an image and OBJECTS prompts: of a dataset with the prompts label_2, else generated."""
    candidates = (generate(seed).frame for seed in count()) if folder is None else _on_disk(folder)
    useful = (frame for frame in candidates if len(frame.prompts) >= OBJECTS and frame.image is not None)
    return [
        replace(frame, prompts=frame.prompts[:OBJECTS], instance_ids=None)
        for frame in islice(useful, how_many)
    ]


def prepare(url: str, chosen: Sequence[Frame]) -> dict[str, list[Prepared]]:
    """The requests to the service at `url` by kind, one for each frame."""
    settings = preset(DEFAULT_PRESET)
    made: dict[str, list[Prepared]] = {LABEL: [], FIND: [], DETECT: []}
    for frame in chosen:
        assert frame.image is not None
        image_parts = parts_of_image(frame.image, frame.calibration, None, None, frame.name)
        made[LABEL].append(form_request(url, LABEL, "/label", form_of_frame(frame, settings)))
        made[FIND].append(form_request(url, FIND, "/label", form_of_frame(frame, settings, detect=True)))
        made[DETECT].append(form_request(url, DETECT, "/detect", image_parts))
    return made


def form_request(url: str, kind: str, path: str, form: Any) -> Prepared:
    """POST with a form, as httpx writes it."""
    request = httpx.Request("POST", f"{url}{path}", files=form)
    body = request.read()
    headers = {
        "Host": urlsplit(url).netloc,
        "Content-Type": request.headers["content-type"],
        "Content-Length": str(len(body)),
        "Accept": "application/json",
    }
    lines = "".join(f"{name}: {value}\r\n" for name, value in headers.items())
    return Prepared(kind, f"POST {path} HTTP/1.1\r\n{lines}\r\n".encode() + body)


def mixed(made: Mapping[str, Sequence[Prepared]], seed: int = 0) -> Iterator[Prepared]:
    """Requests without end: every five have the shares of MIX, in an order that is drawn."""
    draw = random.Random(seed)
    streams = {kind: cycle(requests) for kind, requests in made.items()}
    while True:
        five = [kind for kind, share in MIX.items() for _ in range(round(5 * share))]
        draw.shuffle(five)
        yield from (next(streams[kind]) for kind in five)


def _on_disk(folder: Path) -> Iterator[Frame]:
    source = open_source(folder)
    for name in source.names:
        try:
            frame = source.load(name, load_prompts("label_2", source, name), with_image=True)
        except DatasetError:
            continue  # a frame without LiDAR
        yield frame
