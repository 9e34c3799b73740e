"""Files made to do harm: archives, bombs, sizes that lie, and images that keep a decoder busy."""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import struct
import tarfile
import tracemalloc
import zipfile
import zlib
from collections.abc import Callable

import numpy as np
import pytest
from PIL import Image

from boxlift.errors import (
    CalibrationError,
    ImageError,
    InputError,
    PointCloudError,
    PromptError,
)
from boxlift.formats.calibration import parse_calibration
from boxlift.formats.image import decode_image, decode_instance_ids, image_size
from boxlift.formats.point_cloud import decode_points
from boxlift.formats.prompts import parse_prompts
from fuzz import seeds
from fuzz.containers import png_of

POINTS = seeds.kitti_bin()[0]


def in_sixteens(data: bytes) -> bytes:
    """Padded to whole KITTI returns, as which it would be read."""
    return data + bytes(-len(data) % 16)


def tar_of(data: bytes) -> bytes:
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w") as archive:
        info = tarfile.TarInfo("000001.bin")
        info.size = len(data)
        archive.addfile(info, io.BytesIO(data))
    return stream.getvalue()


ZIP = seeds.npz_of([("000001.bin", POINTS)])
ARCHIVES = {
    "gzip": gzip.compress(POINTS),
    "bzip2": bz2.compress(POINTS),
    "xz": lzma.compress(POINTS),
    "tar": tar_of(POINTS),
    "zip": ZIP,
    "zip in zip": seeds.npz_of([("inner.zip", ZIP)]),
    "7z": b"7z\xbc\xaf\x27\x1c" + bytes(26),
    "rar": b"Rar!\x1a\x07\x01\x00" + bytes(24),
    "zstd": b"\x28\xb5\x2f\xfd" + bytes(28),
    "lz4": b"\x04\x22\x4d\x18" + bytes(28),
    "tar.gz": gzip.compress(tar_of(POINTS)),
}


@pytest.mark.parametrize("kind", ARCHIVES)
@pytest.mark.parametrize(
    ("decode", "error_type"),
    [
        (decode_points, PointCloudError),
        (parse_calibration, CalibrationError),
        (parse_prompts, PromptError),
        (decode_image, ImageError),
        (image_size, ImageError),
        (decode_instance_ids, PromptError),
    ],
)
def test_archives_are_called_so(
    kind: str, decode: Callable[[bytes], object], error_type: type[InputError]
) -> None:
    with pytest.raises(error_type, match=r"packed by|\.(zip|tar|7z|rar) archive"):
        decode(in_sixteens(ARCHIVES[kind]))


def npz_with(**changes: int) -> bytes:
    """An .npz of 200 zeros whose directory says something else of it."""
    return rewritten_npz(seeds.npz_of([("points.npy", seeds.npy()[0])]), **changes)


def rewritten_npz(data: bytes, **changes: int) -> bytes:
    """With other numbers in the first entry of the directory: flags, method, packed_bytes, unpacked_bytes."""
    places = {
        "flags": (8, "<H"),
        "method": (10, "<H"),
        "packed_bytes": (20, "<I"),
        "unpacked_bytes": (24, "<I"),
    }
    damaged = bytearray(data)
    entry, local = data.index(b"PK\x01\x02"), data.index(b"PK\x03\x04")
    for name, number in changes.items():
        offset, how = places[name]
        struct.pack_into(how, damaged, entry + offset, number)
        struct.pack_into(how, damaged, local + offset - 2, number)
    return bytes(damaged)


def test_bomb_behind_a_size_that_lies() -> None:
    """256 MB of zeros in 256 kB that call themselves 200 bytes."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    bomb = b"".join(packer.compress(bytes(2**20)) for _ in range(256)) + packer.flush()
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("points.npy", bomb)
    data = rewritten_npz(
        stream.getvalue(), method=zipfile.ZIP_DEFLATED, packed_bytes=len(bomb), unpacked_bytes=200
    )
    tracemalloc.start()
    try:
        with pytest.raises(PointCloudError, match=r"\.zip archive"):
            decode_points(data)
        assert tracemalloc.get_traced_memory()[1] < 2**22
    finally:
        tracemalloc.stop()


def test_sizes_above_the_limit_are_not_unpacked() -> None:
    with pytest.raises(PointCloudError, match="unpacks to 268435457 bytes"):
        decode_points(npz_with(unpacked_bytes=2**28 + 1))


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (npz_with(flags=1), "encrypted"),
        (npz_with(method=zipfile.ZIP_BZIP2), "method 12"),
        (npz_with(method=zipfile.ZIP_LZMA), "method 14"),
        (npz_with(method=99), "method 99"),
        (
            seeds.npz_of([("points.npy", b""), ("Points.npy", b"")]).replace(b"Points", b"points"),
            "2 arrays 'points'",
        ),
        (seeds.npz_of([(f"{index}.npy", b"") for index in range(1001)]), "more than 1000 files"),
        (seeds.npz_of([("points.npy", b"no array")]), "holds no array"),
        (seeds.npz_of([]), "no .npz"),
        (seeds.npz_of([("a.npy", b""), ("b.txt", b"")]), "'b.txt'"),
        (ZIP[:-30], "damaged .zip archive"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_archives_of_arrays_that_are_refused(data: bytes, says: str) -> None:
    with pytest.raises(PointCloudError) as caught:
        decode_points(data)
    assert says in caught.value.problem


def test_pickles_stay_closed() -> None:
    """An array of objects would run what its pickle says."""
    stream = io.BytesIO()
    np.save(stream, np.array([[print] * 3], dtype=object), allow_pickle=True)
    for data in (stream.getvalue(), seeds.npz_of([("points.npy", stream.getvalue())])):
        with pytest.raises(PointCloudError, match="not numbers"):
            decode_points(data)


@pytest.mark.parametrize("dtype", ["<i4", "<i8"])
def test_least_integers_are_far_away(dtype: str) -> None:
    array = np.array([[1, 2, 3], [np.iinfo(dtype).min, 0, 0]], dtype)
    stream = io.BytesIO()
    np.save(stream, array)
    assert decode_points(stream.getvalue()).dropped == 1


def test_infinities_of_half_floats_are_dropped() -> None:
    stream = io.BytesIO()
    np.save(stream, np.array([[1, 2, 3], [np.inf, 0, 0]], np.float16))
    assert decode_points(stream.getvalue()).dropped == 1


HEADER = b"IHDR", struct.pack(">IIBBBBB", 13, 9, 8, 2, 0, 0, 0)
PIXELS = b"IDAT", zlib.compress(bytes(9 * (1 + 3 * 13)))
END = b"IEND", b""


def test_a_png_of_many_chunks() -> None:
    with pytest.raises(ImageError, match="parts"):
        decode_image(png_of([HEADER, *[(b"aaAa", b"")] * 2000, PIXELS, END]))
    with pytest.raises(ImageError, match="parts"):
        decode_image(png_of([HEADER, *[(b"IDAT", b"")] * 2000, PIXELS, END]))
    pixels = [(b"IDAT", PIXELS[1][at : at + 1]) for at in range(len(PIXELS[1]))]
    assert decode_image(png_of([HEADER, *pixels, END])).shape == (9, 13, 3)


BOMB = zlib.compress(bytes(2**24), 9)


@pytest.mark.parametrize(
    "chunk",
    [
        (b"iCCP", b"name\x00\x00" + BOMB),
        (b"zTXt", b"name\x00\x00" + BOMB),
        (b"iTXt", b"name\x00\x01\x00en\x00name\x00" + BOMB),
        (b"tEXt", b"transparency\x00what Pillow would take for its own"),
        (b"eXIf", b"II*\x00\xff\xff\xff\xff"),
        (b"acTL", b"\xff" * 8),
        (b"fcTL", b"\xff" * 26),
        (b"tRNS", b""),
    ],
    ids=lambda chunk: chunk[0].decode(),
)
def test_what_pixels_do_not_need_is_not_read(chunk: tuple[bytes, bytes]) -> None:
    assert not decode_image(png_of([HEADER, chunk, chunk, PIXELS, END])).any()


@pytest.mark.parametrize("size", [(1, 65_536), (65_536, 1), (64_000_000, 1), (0, 5), (5, 0), (2**31, 2**31)])
def test_sides_that_no_image_has(size: tuple[int, int]) -> None:
    header = b"IHDR", struct.pack(">IIBBBBB", *size, 8, 0, 0, 0, 0)
    for read in (image_size, decode_image):
        with pytest.raises(ImageError, match=f"{size[0]} x {size[1]}"):
            read(png_of([header, PIXELS, END]))


def test_a_damaged_png_header_is_no_size() -> None:
    data = bytearray(png_of([HEADER, PIXELS, END]))
    data[19] += 1
    with pytest.raises(ImageError, match="damaged"):
        image_size(bytes(data))


def test_a_second_png_header_does_not_get_by_the_limit() -> None:
    """Decoders take the last one."""
    large = b"IHDR", struct.pack(">IIBBBBB", 13_000, 9000, 8, 2, 0, 0, 0)
    with pytest.raises(ImageError, match="two headers"):
        decode_image(png_of([HEADER, large, PIXELS, END]), max_pixels=117)


def jpeg(progressive: bool = False) -> bytes:
    stream = io.BytesIO()
    Image.new("RGB", (40, 24), (90, 120, 150)).save(stream, "JPEG", progressive=progressive)
    return stream.getvalue()


def test_a_jpeg_of_many_scans() -> None:
    data = jpeg(progressive=True)
    last_scan = data[data.rindex(b"\xff\xda") : -2]
    assert decode_image(data).shape == (24, 40, 3)
    with pytest.raises(ImageError, match="more than 32 scans"):
        decode_image(data[:-2] + last_scan * 32 + data[-2:])


@pytest.mark.parametrize("segment", [b"\xff\xfe\x00\x02", b"\xff\xe1\x00\x02", b"\xff\xdd\x00\x04\x00\x00"])
def test_a_jpeg_of_many_segments(segment: bytes) -> None:
    data = jpeg()
    with pytest.raises(ImageError, match="parts"):
        image_size(data[:2] + segment * 2000 + data[2:])


@pytest.mark.parametrize("junk", [bytes(100_000), b"\xff" * 100_000, b"\xff\x00\xff\xd0ab" * 9])
def test_junk_between_the_segments_of_a_jpeg_is_passed_over(junk: bytes) -> None:
    data = jpeg()
    np.testing.assert_array_equal(decode_image(data[:20] + junk + data[20:]), decode_image(data))


@pytest.mark.parametrize(
    "segment", [b"\xff\x01\x00\x02", b"\xff\xe0\x00\x01", b"\xff\xc0\x00\x03\x08", b"\xff\xd8"]
)
def test_damaged_segments_of_a_jpeg(segment: bytes) -> None:
    data = jpeg()
    with pytest.raises(ImageError, match="damaged segment at byte 20"):
        image_size(data[:20] + segment + data[20:])


def test_what_a_jpeg_carries_besides_its_pixels_changes_nothing() -> None:
    data = jpeg()
    exif = b"Exif\x00\x00II*\x00" + b"\xff" * 60
    parts = b"MPF\x00" + exif, b"ICC_PROFILE\x00\x01\x01" + bytes(9), exif
    segments = b"".join(
        marker + struct.pack(">H", len(body) + 2) + body
        for marker, body in zip((b"\xff\xe2", b"\xff\xe2", b"\xff\xe1"), parts, strict=True)
    )
    loaded = decode_image(data[:20] + segments + data[20:] + b"a video, or another image")
    np.testing.assert_array_equal(loaded, decode_image(data))
