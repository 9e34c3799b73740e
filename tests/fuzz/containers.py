"""Files within files: what is inside is damaged, and the checksums and lengths around it are right again."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from collections.abc import Callable
from random import Random

from fuzz.seeds import lzf_of, lzf_unpacked, npz_of

# Damages some bytes.
Inner = Callable[[bytes], bytes]
Chunk = tuple[bytes, bytes]


def in_png(data: bytes, random: Random, inner: Inner) -> bytes:
    """A PNG with a chunk damaged, twice, missing or elsewhere, or with other pixel data."""
    chunks = _png_chunks(data)
    if not chunks:
        return inner(data)
    at = random.randrange(len(chunks))
    kind, body = chunks[at]
    match random.randrange(6):
        case 0:
            chunks[at : at + 1] = [(kind, body)] * random.choice((0, 2, 50))
        case 1:
            chunks.insert(random.randrange(len(chunks) + 1), chunks.pop(at))
        case 2 if kind in (b"IDAT", b"iCCP", b"zTXt", b"iTXt"):
            start = body.find(b"x\x9c") if kind != b"IDAT" else 0
            chunks[at] = kind, body[:start] + zlib.compress(inner(_inflated(body[start:])), 1)
        case 3:
            chunks[at] = random.choice(chunks)[0], body
        case _:
            chunks[at] = kind, inner(body)
    return png_of(chunks)


def png_of(chunks: list[Chunk]) -> bytes:
    """A PNG of any chunks, whose lengths and checksums are right."""
    parts = (
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        for kind, body in chunks
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def in_jpeg(data: bytes, random: Random, inner: Inner) -> bytes:
    """A JPEG with a segment damaged, repeated, missing or elsewhere; the length in it is right."""
    segments, rest = _jpeg_segments(data)
    if not segments:
        return inner(data)
    at = random.randrange(len(segments))
    kind, body = segments[at]
    match random.randrange(4):
        case 0:
            segments[at : at + 1] = [(kind, body)] * random.choice((0, 2, 50))
        case 1:
            segments.insert(random.randrange(len(segments) + 1), segments.pop(at))
        case 2:
            rest = rest * random.choice((2, 20)) if random.random() < 0.3 else inner(rest)
        case _:
            segments[at] = kind, inner(body)[:65_533]
    parts = (kind + struct.pack(">H", len(body) + 2) + body for kind, body in segments)
    return b"\xff\xd8" + b"".join(parts) + rest


def in_npz(data: bytes, random: Random, inner: Inner) -> bytes:
    """An archive with a damaged array, name, way of packing or number of members."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = [(info.filename, archive.read(info)) for info in archive.infolist()]
    except Exception:  # whatever is wrong with an archive that was damaged before
        return inner(data)
    if not members:
        return inner(data)
    at = random.randrange(len(members))
    name, body = members[at]
    match random.randrange(4):
        case 0:
            members = [(f"{index}{name}", body[:200]) for index in range(random.choice((0, 2, 90)))]
        case 1:
            members[at] = inner(name.encode()).decode("latin-1")[:20_000] or "x", body
        case _:
            members[at] = name, inner(body)
    return npz_of(members, random.random() < 0.7)


def in_lzf(data: bytes, random: Random, inner: Inner) -> bytes:
    """A compressed .pcd with other columns in it."""
    head, mark, body = data.partition(b"DATA binary_compressed\n")
    if len(body) < 9 or random.random() < 0.4:
        return inner(data)
    columns = inner(body[8:] if random.random() < 0.2 else _unpacked(body))[:60_000]
    packed = lzf_of(columns)
    return head + mark + struct.pack("<II", len(packed), len(columns)) + packed


def _png_chunks(data: bytes) -> list[Chunk]:
    chunks: list[Chunk] = []
    at = 8
    while at + 8 <= len(data) and len(chunks) < 200:
        (size,) = struct.unpack_from(">I", data, at)
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + size]))
        at += 12 + size
    return chunks


def _jpeg_segments(data: bytes) -> tuple[list[Chunk], bytes]:
    """Marker segments up to the first scan, and what follows them."""
    segments: list[Chunk] = []
    at = 2
    while data[at : at + 1] == b"\xff" and at + 4 <= len(data) and len(segments) < 200:
        kind = data[at : at + 2]
        (size,) = struct.unpack_from(">H", data, at + 2)
        segments.append((kind, data[at + 4 : at + 2 + size]))
        at += 2 + max(size, 2)
        if kind == b"\xff\xda":
            break
    return segments, data[at:]


def _inflated(data: bytes) -> bytes:
    try:
        return zlib.decompressobj().decompress(data, 100_000)
    except zlib.error:
        return data


def _unpacked(body: bytes) -> bytes:
    packed, unpacked = struct.unpack_from("<II", body)
    return lzf_unpacked(body[8 : 8 + packed], min(unpacked, 100_000) or 1) or body[8:]
