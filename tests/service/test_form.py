from __future__ import annotations

import asyncio
from collections.abc import Mapping
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from starlette.requests import Request
from starlette.types import Message

from boxlift_service.bodies.form import Field, read_form
from boxlift_service.bodies.shared_parts import HeldBytes, Part
from boxlift_service.problems import Kind, ProblemError

FIELDS = {"points": Field(1000, required=True), "name": Field(5)}


def read(chunks: list[bytes], fields: Mapping[str, Field] = FIELDS) -> dict[str, tuple[Part, ...]]:
    messages: list[Message] = [
        {"type": "http.request", "body": chunk, "more_body": index < len(chunks) - 1}
        for index, chunk in enumerate(chunks)
    ]

    async def receive() -> Message:
        return messages.pop(0)

    content_type = (b"content-type", b"multipart/form-data; boundary=line")
    request = Request({"type": "http", "method": "POST", "headers": [content_type]}, receive)
    held = HeldBytes(2000)
    try:
        with asyncio.run(read_form(request, fields, held)) as parts:
            assert held.taken == sum(parts.size(name) for name in fields)
            return {name: parts.read(name) for name in fields if name in parts}
    finally:
        assert held.taken == 0


def form(points: bytes, name: bytes = b"abc") -> bytes:
    return (
        b'--line\r\nContent-Disposition: form-data; name="points"; filename="p.bin"\r\n'
        b"Content-Type: application/octet-stream\r\n\r\n" + points + b"\r\n"
        b'--line\r\nContent-Disposition: form-data; name="name"\r\n\r\n' + name + b"\r\n--line--\r\n"
    )


@given(
    points=st.binary(max_size=60) | st.text("\r\n-line", max_size=60).map(str.encode),
    cuts=st.lists(st.integers(0, 260), max_size=8),
)
def test_parts_do_not_depend_on_how_the_body_was_cut(points: bytes, cuts: list[int]) -> None:
    if b"\r\n--line" in b"\r\n" + points:
        return  # the boundary of a form is chosen so that it does not occur in it
    body = form(points)
    edges = [0, *sorted(cuts), len(body)]
    chunks = [body[start:end] for start, end in pairwise(edges)]
    assert read(chunks) == {"points": (Part(points, "p.bin"),), "name": (Part(b"abc"),)}


@pytest.mark.parametrize(
    ("body", "kind", "field"),
    [
        (form(bytes(1001)), Kind.TOO_LARGE, "points"),
        (form(b"", b"abcdef"), Kind.TOO_LARGE, "name"),
        (form(b"").replace(b'"name"', b'"points"'), Kind.INVALID_FIELD, "points"),
        (form(b"").replace(b'"points"', b'"pionts"'), Kind.INVALID_FIELD, "pionts"),
        (form(b"")[form(b"").index(b"\r\n--line") + 2 :], Kind.INVALID_FIELD, "points"),
        (form(b"")[:-8], Kind.UNREADABLE_BODY, None),
    ],
    ids=["large", "large text", "twice", "unknown", "missing", "cut"],
)
def test_refusals(body: bytes, kind: Kind, field: str | None) -> None:
    with pytest.raises(ProblemError) as caught:
        read([body])
    assert (caught.value.kind, caught.value.field) == (kind, field)


def test_a_field_may_come_several_times_in_its_order() -> None:
    images = b"".join(
        b'--line\r\nContent-Disposition: form-data; name="image"\r\n\r\n%d\r\n' % number
        for number in range(4)
    )
    body = images + b"--line--\r\n"
    parts = read([body], {"image": Field(9, max_parts=4)})
    assert [part.data for part in parts["image"]] == [b"0", b"1", b"2", b"3"]
    with pytest.raises(ProblemError) as caught:
        read([body], {"image": Field(9, max_parts=3)})
    assert caught.value.problem == "The field 'image' comes 4 times."
    assert caught.value.remedy == "Send it at most 3 times."
