"""Inputs of the largest size that the service takes, each made to take as long or as much as it can.

    python -m fuzz.large

prints what each costs; see benchmarks/fuzz_decoders.py.
"""

from __future__ import annotations

import io
import json
import os
import struct
import sys
import time
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from boxlift.errors import InputError
from boxlift.formats.calibration import parse_calibration
from boxlift.formats.image import decode_image, image_size
from boxlift.formats.point_cloud import decode_points
from boxlift.formats.prompts import parse_prompts
from boxlift.formats.size_priors import parse_size_priors
from fuzz.decoders import decoders
from fuzz.seeds import lzf_of

# Limits of the fields of POST /label.
_BODY = 64 * 2**20
_CALIB, _PROMPTS, _OPTIONS = 2**20, 2**22, 2**16

Case = tuple[str, Callable[[bytes], object], bytes]


def cases() -> Iterator[Case]:
    """What it is, what decodes it, and the data."""
    yield from _clouds()
    yield from _texts()
    yield from _images()


def _clouds() -> Iterator[Case]:
    yield "bin, all returns far away", decode_points, np.full(_BODY // 4, 1e30, "<f4").tobytes()
    yield (
        "bin, one return in two",
        decode_points,
        np.tile(np.array([[1.0] * 4, [1e30] * 4], np.float32), (2**21, 1)).tobytes(),
    )
    head = b"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1\nHEIGHT 1\n"
    count = _BODY // 6 - 100
    yield "pcd, shortest lines", decode_points, head + b"POINTS %d\nDATA ascii\n" % count + b"0 1 2\n" * count
    yield "pcd, blank lines", decode_points, head + b"POINTS 1\nDATA ascii\n" + b"\n" * _BODY
    yield "pcd, one line", decode_points, head + b"POINTS 1\nDATA ascii\n" + b"0 " * (_BODY // 2)
    yield (
        "pcd, lines of 60 kB",
        decode_points,
        head + b"POINTS 900\nDATA ascii\n" + (b"0 " * 30_000 + b"\n") * 1000,
    )
    many = 8000
    fields = b"FIELDS x y z" + b" a" * many + b"\nSIZE 4 4 4" + b" 1" * many + b"\nTYPE F F F" + b" U" * many
    wide = fields + b"\nCOUNT 1 1 1" + b" 1" * many + b"\nPOINTS 1\nDATA binary\n"
    yield f"pcd, {many} fields", decode_points, wide + bytes(12 + many)
    zeros = lzf_of(bytes(2**28 - 2**28 % 12))
    length = struct.pack("<II", len(zeros), 2**28 - 2**28 % 12)
    yield (
        "pcd, 256 MB of LZF",
        decode_points,
        head + b"POINTS %d\nDATA binary_compressed\n" % (2**28 // 12) + length + zeros,
    )
    properties = b"".join(b"property char p%d\n" % index for index in range(3000))
    axes = b"".join(b"property float %c\n" % axis for axis in b"xyz")
    ply = b"ply\nformat %s 1.0\nelement vertex %d\n%send_header\n"
    yield (
        "ply, 3003 properties",
        decode_points,
        ply % (b"binary_big_endian", 1, axes + properties) + bytes(3012),
    )
    yield "ply, shortest lines", decode_points, ply % (b"ascii", count, axes) + b"0 1 2\n" * count
    yield "npz, 256 MB of zeros", decode_points, _npz_of_zeros(2**28 - 128)
    entry = struct.pack("<IHHHHHHIIIHHHHHII", 0x02014B50, *[0] * 9, 1, *[0] * 6) + b"a"
    entries = entry * (_BODY // len(entry))
    end = struct.pack("<IHHHHIIH", 0x06054B50, 0, 0, 65_535, 65_535, len(entries), 4, 0)
    yield "npz, a million entries", decode_points, b"PK\x03\x04" + entries + end


def _texts() -> Iterator[Case]:
    yield "calib, one line", parse_calibration, b"P2: " + b"0 " * (_CALIB // 2)
    yield "calib, lines", parse_calibration, b"".join(b"a%d\n" % index for index in range(_CALIB // 8))
    yield "calib, keys of JSON", parse_calibration, _keys(_CALIB)
    yield "calib, nested", parse_calibration, b'{"P2": ' + b"[" * _CALIB
    yield (
        "prompts, 65,535",
        parse_prompts,
        json.dumps([{"class": "Car", "box": [1, 2, 3, 4]}] * 65_535).encode(),
    )
    yield "prompts, brackets", parse_prompts, b"[" + b"[]," * (_PROMPTS // 3) + b"[]]"
    yield "prompts, nested", parse_prompts, b"[" * _PROMPTS
    yield "prompts, keys", parse_prompts, b"[" + _keys(_PROMPTS) + b"]"
    yield "prompts, equal keys", parse_prompts, b"[{" + b'"a":1,' * (_PROMPTS // 6) + b'"a":1}]'
    yield "prompts, digits", parse_prompts, b"[" + (b"9" * 4300 + b",") * (_PROMPTS // 4301) + b"1]"
    yield "prompts, one string", parse_prompts, b'["' + b"\\u0000" * (_PROMPTS // 6) + b'"]'
    options = decoders()["options"].decode
    yield "options, keys", options, _keys(_OPTIONS)
    yield "options, classes", options, b'{"sizes": ' + _keys(_OPTIONS) + b"}"
    yield "options, nested", options, b'{"ground": ' * 5000 + b"1" + b"}" * 5000
    priors = "".join(f"a.b{index} = 1\n" for index in range(_OPTIONS // 12)).encode()
    yield "priors, dotted keys", lambda data: parse_size_priors(data.decode()), priors


def _images() -> Iterator[Case]:
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    def png(width: int, height: int, chunks: bytes) -> bytes:
        header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
        return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunks + chunk(b"IEND", b"")

    small = chunk(b"IDAT", bytes(250))
    yield "png, size, chunks of 250 bytes", image_size, png(8000, 8000, small * (_BODY // len(small)))
    yield "png, size, empty chunks", image_size, png(8000, 8000, chunk(b"IDAT", b"") * (_BODY // 12))
    yield (
        "png, 64 megapixels of zeros",
        decode_image,
        png(8000, 8000, chunk(b"IDAT", _packed_zeros(8000 * 24_001))),
    )
    yield "png, 976 x 65,535", decode_image, png(976, 65_535, chunk(b"IDAT", _packed_zeros(65_535 * 2929)))
    picture = io.BytesIO()
    Image.new("RGB", (8000, 8000), (90, 100, 110)).save(picture, "JPEG", progressive=True)
    data = picture.getvalue()
    yield "jpeg, 64 megapixels, 10 scans", decode_image, data
    scan = data[data.rindex(b"\xff\xda") : -2]
    yield "jpeg, 64 megapixels, 32 scans", decode_image, data[:-2] + scan * 22 + data[-2:]
    yield "jpeg, size, segments", image_size, data[:2] + b"\xff\xfe\x00\x02" * (_BODY // 4)
    yield "jpeg, size, fill", image_size, data[:2] + b"\xff" * _BODY
    start = data.index(b"\xff\xda")
    yield (
        "jpeg, size, stuffed bytes",
        image_size,
        data[:start] + b"\xff\xda\x00\x02" + b"\xff\x00" * (_BODY // 2),
    )
    long_segment = b"\xff\xe1\xff\xff" + b"Exif\x00\x00" + bytes(65_527)
    yield "jpeg, 64 MB of Exif", decode_image, data[:2] + long_segment * 1000 + data[2:]


def _keys(size: int) -> bytes:
    return b"{" + b",".join(b'"a%d":1' % index for index in range(size // 12)) + b"}"


def _packed_zeros(size: int) -> bytes:
    packer = zlib.compressobj(9)
    whole, rest = divmod(size, 2**20)
    return b"".join(
        [*(packer.compress(bytes(2**20)) for _ in range(whole)), packer.compress(bytes(rest)), packer.flush()]
    )


def _npz_of_zeros(size: int) -> bytes:
    rows = size // 12
    header = f"{{'descr': '<f4', 'fortran_order': False, 'shape': ({rows}, 3), }}".ljust(117).encode() + b"\n"
    stream = io.BytesIO()
    with (
        zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("points.npy", "w") as member,
    ):
        member.write(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header)
        for at in range(0, rows * 12, 2**20):
            member.write(bytes(min(2**20, rows * 12 - at)))
    return stream.getvalue()


@dataclass(frozen=True)
class Cost:
    """Processor time, memory beyond the input itself, and what came of it."""

    seconds: float
    peak_bytes: int
    outcome: str


def cost_of(decode: Callable[[bytes], object], data: bytes) -> Cost:
    """Decode in a process of its own."""
    here, there = os.pipe()
    if child := os.fork():
        os.close(there)
        with os.fdopen(here) as stream:
            values = json.loads(stream.read() or '[0, 0, "the process ended"]')
        os.waitpid(child, 0)
        return Cost(*values)
    try:
        Path("/proc/self/clear_refs").write_text("5")  # the peak so far is no longer one
        before, start = _peak_bytes(), time.thread_time()
        outcome = _outcome(decode, data)
        cost = time.thread_time() - start, _peak_bytes() - before, outcome
        os.write(there, json.dumps(cost).encode())
    finally:
        os._exit(0)


def _outcome(decode: Callable[[bytes], object], data: bytes) -> str:
    try:
        decode(data)
    except InputError as error:
        return f"refused: {error.problem:.70}"
    except BaseException as error:
        return f"FOUND {error!r:.100}"
    return "decoded"


def _peak_bytes() -> int:
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if "VmHWM" in line)
    return 1024 * int(line.split()[1])


def _main() -> None:
    print("| input made to be slow | MB | processor time, s | memory beyond it, MB | |")
    print("|---|---|---|---|---|")
    found = False
    for name, decode, data in cases():
        cost = cost_of(decode, data)
        found |= not cost.outcome.startswith(("decoded", "refused"))
        print(
            f"| {name} | {len(data) / 1e6:.2f} | {cost.seconds:.2f} | {cost.peak_bytes / 1e6:.0f} "
            f"| {cost.outcome} |",
            flush=True,
        )
    sys.exit(found)


if __name__ == "__main__":
    _main()
