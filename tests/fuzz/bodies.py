"""The service's own readers of request bodies, as decoders to fuzz."""

from __future__ import annotations

import zlib
from collections.abc import AsyncIterator, Coroutine
from random import Random
from typing import Any

import msgpack
from starlette.requests import Request

from boxlift.errors import InputError
from boxlift_service.bodies.form import Field, read_form
from boxlift_service.bodies.msgpack_frames import read_msgpack
from boxlift_service.bodies.shared_parts import Part, SharedParts
from boxlift_service.problems import ProblemError
from fuzz import seeds

BOUNDARY = b"a-boundary"
_FIELDS = {
    "points": Field(2000, required=True),
    "calib": Field(500, required=True),
    "image": Field(1000, max_parts=2),
    "name": Field(50),
}
_Parts = dict[str, tuple[Part, ...]]


def read_form_body(data: bytes) -> None:
    """A form whose boundary is known."""
    _read_both_ways(data, _form_parts)


def read_form_type(data: bytes) -> None:
    """The Content-Type of a form, a line break, and its body."""
    content_type, _, body = data.partition(b"\n")
    _read(_form_parts([body], content_type))


def read_msgpack_body(data: bytes) -> None:
    """A map of the fields of a frame."""
    _read_both_ways(data, _msgpack_parts)


def form_bodies() -> tuple[bytes, ...]:
    """Forms with files and without, of few fields and of many."""
    few = _form([("points", "a.bin", seeds.kitti_bin()[0]), ("calib", None, b"P2: 1")])
    many = _form(
        [
            ("calib", None, b""),
            ("image", "0.png", seeds.masks()[0]),
            ("image", "\u00e9.png", b"--" + BOUNDARY),
            ("points", None, b"\r\n--" + BOUNDARY[:4] + b"\r\n"),
            ("name", None, "\u00e9".encode()),
        ]
    )
    return few, many, few + b"an epilogue"


def form_types() -> tuple[bytes, ...]:
    """Content-Types with their bodies."""
    body = form_bodies()[0]
    kinds = b"multipart/form-data; boundary=%s", b'Multipart/Form-Data; charset=utf-8; BOUNDARY="%s"'
    return tuple(kind % BOUNDARY + b"\n" + body for kind in kinds)


def msgpack_bodies() -> tuple[bytes, ...]:
    """Maps of bin, of str, and with a file's name."""
    frame = {"points": seeds.kitti_bin()[0], "calib": "P2: 1", "points_filename": "a.bin"}
    packed: list[bytes] = [
        msgpack.packb(frame),
        msgpack.packb({**frame, "image": bytes(300), "name": "\u00e9"}, use_bin_type=True),
        b"\xde\x00\x02"
        + msgpack.packb("points")
        + msgpack.packb(b"1")
        + msgpack.packb("calib")
        + b"\xdb\0\0\0\0",
    ]
    return tuple(packed)


def _form(parts: list[tuple[str, str | None, bytes]]) -> bytes:
    body = b""
    for name, filename, data in parts:
        file = (
            "" if filename is None else f'; filename="{filename}"\r\nContent-Type: application/octet-stream'
        )
        head = f'Content-Disposition: form-data; name="{name}"{file}\r\n\r\n'.encode()
        body += b"--" + BOUNDARY + b"\r\n" + head + data + b"\r\n"
    return body + b"--" + BOUNDARY + b"--\r\n"


def _read_both_ways(data: bytes, read: Any) -> None:
    """The same comes of a body however it is cut into chunks. Raises InputError where it is refused."""
    random = Random(zlib.crc32(data))
    cuts = sorted([1, *(random.randrange(len(data) + 1) for _ in range(random.choice((1, 3, 40))))])
    pieces = [data[start:end] for start, end in zip([0, *cuts], [*cuts, len(data)], strict=True)]
    try:
        in_pieces: _Parts | str = _read(read(pieces))
    except InputError as error:
        in_pieces = str(error)
    try:
        whole: _Parts | str = _read(read([data]))
    except InputError as error:
        whole = str(error)
        assert isinstance(in_pieces, str), "whole it is refused, in pieces it is not"
        raise
    assert whole == in_pieces


def _read(reading: Coroutine[Any, Any, SharedParts]) -> _Parts:
    try:
        with _at_once(reading) as parts:
            found = {name: parts.read(name) for name in _FIELDS if name in parts}
    except ProblemError as error:
        if error.kind.status not in (400, 413, 415, 422):
            raise
        raise InputError(error.field or "body", error.problem, error.remedy) from None
    assert {"points", "calib"} <= found.keys()
    for name, several in found.items():
        assert len(several) <= _FIELDS[name].max_parts
        assert all(len(part.data) <= _FIELDS[name].max_bytes for part in several)
    return found


def _form_parts(
    chunks: list[bytes], content_type: bytes = b"multipart/form-data; boundary=" + BOUNDARY
) -> Coroutine[Any, Any, SharedParts]:
    left = [b"", *reversed(chunks)]

    async def receive() -> dict[str, object]:
        return {"type": "http.request", "body": left.pop(), "more_body": bool(left)}

    scope = {"type": "http", "headers": [(b"content-type", content_type)]}
    return read_form(Request(scope, receive), _FIELDS)


def _msgpack_parts(chunks: list[bytes]) -> Coroutine[Any, Any, SharedParts]:
    async def stream() -> AsyncIterator[bytes]:
        for chunk in chunks:
            yield chunk

    return read_msgpack(stream(), _FIELDS)


def _at_once(reading: Coroutine[Any, Any, SharedParts]) -> SharedParts:
    """Run what never has to wait."""
    try:
        reading.send(None)
    except StopIteration as finished:
        parts: SharedParts = finished.value
        return parts
    raise AssertionError("it waits")
