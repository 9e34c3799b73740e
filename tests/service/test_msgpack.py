from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping
from itertools import pairwise
from typing import Any

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boxlift_service.bodies.form import Field
from boxlift_service.bodies.msgpack_frames import MapReader, is_msgpack, read_msgpack
from boxlift_service.bodies.shared_parts import HeldBytes, Part, SharedParts
from boxlift_service.problems import Kind, ProblemError

FIELDS = {"points": Field(70_000, required=True), "name": Field(5), "image": Field(70_000)}


async def chunked(body: bytes, *cuts: int) -> AsyncIterator[bytes]:
    """The body cut at these places, as a request's stream comes; it ends with an empty chunk."""
    edges = [0, *sorted(cuts), len(body)]
    for start, end in pairwise(edges):
        yield body[start:end]
    yield b""


def read(body: bytes, *cuts: int, held: HeldBytes | None = None) -> dict[str, Part]:
    """The parts of a body that is one map."""
    with asyncio.run(read_msgpack(chunked(body, *cuts), FIELDS, held)) as parts:
        return {name: parts.read(name)[0] for name in FIELDS if name in parts}


def read_stream(
    body: bytes, *, held: HeldBytes | None = None, max_bytes: int = 100_000, **reader_options: float
) -> list[tuple[dict[str, bytes], Kind | None]]:
    """What is kept of each map of a stream, and what is wrong with it."""

    async def read_all() -> list[tuple[dict[str, bytes], Kind | None]]:
        reader = MapReader(chunked(body, 1, 7, 500), FIELDS, held, max_bytes=max_bytes, **reader_options)
        found = []
        while not await reader.at_end():
            with SharedParts(held) as parts:
                problem = await reader.read_map(parts)
                kept = {name: parts.read(name)[0].data for name in FIELDS if name in parts}
                found.append((kept, None if problem is None else problem.kind))
        return found

    return asyncio.run(read_all())


def pack(*maps: Mapping[Any, Any], **options: Any) -> bytes:
    return b"".join(msgpack.packb(dict(one), **options) for one in maps)


@given(
    points=st.binary(max_size=400) | st.integers(0, 70_000).map(bytes),
    name=st.text("aé", max_size=2),
    filename=st.none() | st.text(max_size=40),
    as_bin=st.booleans(),
    cuts=st.lists(st.integers(0, 100_000), max_size=8),
)
def test_parts_are_what_the_library_packed_however_it_is_cut(
    points: bytes, name: str, filename: str | None, as_bin: bool, cuts: list[int]
) -> None:
    fields: dict[str, Any] = {"points": points, "name": name.encode() if as_bin else name}
    if filename is not None:
        fields["points_filename"] = filename
    body = pack(fields)
    expected = {"points": Part(points, filename), "name": Part(name.encode())}
    assert read(body, *(cut % len(body) for cut in cuts)) == expected
    # An older library packs bytes as raw, which is str now.
    assert read(pack(fields, use_bin_type=False)) == expected


def test_the_file_name_may_come_first() -> None:
    body = pack({"points_filename": "a.pcd", "points": b"0"})
    assert read(body) == {"points": Part(b"0", "a.pcd")}


LONG_MAP = {str(number): b"" for number in range(101)}
REFUSALS: dict[str, tuple[bytes, Kind, str | None]] = {
    "unknown": (pack({"points": b"", "pionts": b""}), Kind.INVALID_FIELD, "pionts"),
    "missing": (pack({"name": b""}), Kind.INVALID_FIELD, "points"),
    "twice": (b"\x82\xa6points\xc4\x00\xa6points\xc4\x00", Kind.INVALID_FIELD, "points"),
    "large": (pack({"points": bytes(70_001)}), Kind.TOO_LARGE, "points"),
    "large text": (pack({"points": b"", "name": "abcdef"}), Kind.TOO_LARGE, "name"),
    "large file name": (
        pack({"points": b"", "points_filename": "f" * 1001}),
        Kind.TOO_LARGE,
        "points_filename",
    ),
    "empty body": (b"", Kind.UNREADABLE_BODY, None),
    "two maps": (pack({"points": b""}, {"points": b""}), Kind.UNREADABLE_BODY, None),
    "cut": (pack({"points": bytes(99)})[:-1], Kind.UNREADABLE_BODY, None),
    "cut in a length": (b"\x81\xa6points\xc6\x00\x00", Kind.UNREADABLE_BODY, None),
    "promises 4 GB": (b"\x81\xa6points\xc6\xff\xff\xff\xff", Kind.UNREADABLE_BODY, None),
    "no map": (msgpack.packb(["points", b""]), Kind.UNREADABLE_BODY, None),
    "JSON": (b'{"points": ""}', Kind.UNREADABLE_BODY, None),
    "a form": (b'--line\r\nContent-Disposition: form-data; name="points"', Kind.UNREADABLE_BODY, None),
    "long map": (pack(LONG_MAP), Kind.UNREADABLE_BODY, None),
    "map of billions": (b"\xdf\xff\xff\xff\xff", Kind.UNREADABLE_BODY, None),
    "long key": (pack({"k" * 101: b""}), Kind.UNREADABLE_BODY, None),
    "key of bytes": (pack({b"points": b""}, use_bin_type=True), Kind.UNREADABLE_BODY, None),
    "list as value": (pack({"points": b"", "name": ["a"]}), Kind.UNREADABLE_BODY, None),
    "map as value": (pack({"points": {"points": b""}}), Kind.UNREADABLE_BODY, None),
    "number as value": (pack({"points": 1}), Kind.UNREADABLE_BODY, None),
    "null as value": (pack({"points": None}), Kind.UNREADABLE_BODY, None),
    "extension": (pack({"points": msgpack.ExtType(1, b"0")}), Kind.UNREADABLE_BODY, None),
}


@pytest.mark.parametrize(("body", "kind", "field"), REFUSALS.values(), ids=REFUSALS)
def test_refusals(body: bytes, kind: Kind, field: str | None) -> None:
    held = HeldBytes(1_000_000)
    with pytest.raises(ProblemError) as caught:
        read(body, held=held)
    assert (caught.value.kind, caught.value.field) == (kind, field)
    assert caught.value.remedy
    assert held.taken == 0


@given(
    st.binary(max_size=60)
    | st.lists(st.sampled_from(sorted(REFUSALS.values())), max_size=3).map(
        lambda refusals: b"".join(body for body, _, _ in refusals)
    )
)
def test_no_bytes_are_a_fault_of_ours(body: bytes) -> None:
    held, ended_by = HeldBytes(1_000_000), None
    try:
        read_stream(body, held=held)
    except ProblemError as error:
        ended_by = error.kind
    assert ended_by in (None, Kind.UNREADABLE_BODY)
    assert held.taken == 0


def test_a_map_at_fault_costs_no_other() -> None:
    good = {"name": "a", "points": bytes(300)}
    found = read_stream(
        pack(
            good,
            {"points": bytes(70_001), "name": "b"},
            {"points": bytes(60_000), "image": bytes(60_000), "name": "c"},
            {"mask": bytes(80_000), "name": "d", "points": b"1"},
            {"name": "e"},
            good,
        )
    )
    kept = {"name": b"a", "points": bytes(300)}
    assert found == [
        (kept, None),
        ({"name": b"b"}, Kind.TOO_LARGE),
        ({"name": b"c", "points": bytes(60_000)}, Kind.TOO_LARGE),
        ({"name": b"d", "points": b"1"}, Kind.INVALID_FIELD),
        ({"name": b"e"}, Kind.INVALID_FIELD),
        (kept, None),
    ]


def test_without_room_a_map_fails_and_the_next_is_read() -> None:
    held = HeldBytes(1000)
    large = {"name": "a", "points": bytes(2000), "image": b"1"}
    found = read_stream(pack(large, {"name": "b", "points": bytes(900)}), held=held)
    assert found == [({"name": b"a"}, Kind.TOO_BUSY), ({"name": b"b", "points": bytes(900)}, None)]
    assert held.taken == 0


def test_room_that_comes_in_time_is_waited_for() -> None:
    held = HeldBytes(1000)
    body = pack({"points": bytes(600)})

    async def read_while_room_comes() -> ProblemError | None:
        reader = MapReader(chunked(body), FIELDS, held, waits_for_room_s=60)
        held.take(600)
        asyncio.get_running_loop().call_later(0.1, held.give_back, 600)
        with SharedParts(held) as parts:
            problem = await reader.read_map(parts)
            assert parts.read("points")[0].data == bytes(600)
        return problem

    assert asyncio.run(read_while_room_comes()) is None


@pytest.mark.parametrize(
    ("content_type", "expected"),
    [
        ("application/msgpack", True),
        ("Application/X-MsgPack; charset=binary", True),
        ("application/vnd.msgpack", True),
        ("application/json", False),
        ("", False),
    ],
)
def test_media_types(content_type: str, expected: bool) -> None:
    assert is_msgpack(content_type) is expected
