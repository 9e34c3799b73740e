"""What PNG and JPEG files are made of: read before any decoder sees them, in bounded time.

Only what the pixels need is passed on. Texts, profiles, Exif, thumbnails and further frames, most of
what decoders have been attacked through, are left out, and so is what follows the image.

Sources of the formats: PNG specification, third edition (W3C, 2025); ITU-T T.81 (1992), annex B.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
JPEG_MAGIC = b"\xff\xd8\xff"

# A decoder spends time on each part, however small it is, and on the whole image in each scan.
_MOST_PARTS = 1000
_BYTES_PER_FURTHER_PART = 256
_MOST_SCANS = 32

_PNG_PIXEL_CHUNKS = (b"IHDR", b"PLTE", b"IDAT", b"IEND")
_DHT, _DAC, _DQT, _DRI, _SOS = 0xC4, 0xCC, 0xDB, 0xDD, 0xDA
_SOI, _EOI, _LEAST_MARKER = 0xD8, 0xD9, 0xC0
_APP0_JFIF, _APP14_ADOBE = 0xE0, 0xEE  # they say which colours there are
_SOF = frozenset(range(0xC0, 0xD0)) - {_DHT, 0xC8, _DAC}
_JPEG_PIXEL_SEGMENTS = {*_SOF, _DHT, _DAC, _DQT, _DRI, _SOS, _EOI, _APP0_JFIF, _APP14_ADOBE}
# Neither a stuffed byte nor a restart: the beginning of a segment, and so the end of a scan's data.
_NEXT_MARKER = re.compile(rb"\xff[^\x00\xff\xd0-\xd7]")


@dataclass(frozen=True)
class ImageParts:
    """size_px: (width, height). data: the file without what its pixels do not need."""

    size_px: tuple[int, int]
    data: bytes


def image_parts(data: bytes) -> ImageParts | None:
    """The parts of a PNG or JPEG file, whole or cut short after its header; None where it is neither.

    Raises ValueError where its structure is damaged, or made to keep a decoder busy.
    """
    if data.startswith(PNG_MAGIC):
        return _png_parts(data)
    if data.startswith(JPEG_MAGIC):
        return _jpeg_parts(data)
    return None


def _png_parts(data: bytes) -> ImageParts:
    header = data[12:29]
    if header[:4] != b"IHDR" or data[29:33] != struct.pack(">I", zlib.crc32(header)):
        raise ValueError("the header of the PNG is missing or damaged")
    view = memoryview(data)
    kept = [view[:8]]
    at = 8
    for _ in _counted(data):
        if at + 8 > len(data):
            break
        size, kind = struct.unpack_from(">I4s", data, at)
        end = at + 12 + size
        if kind == b"IHDR" and at > 8:
            raise ValueError("the PNG has two headers")
        if kind in _PNG_PIXEL_CHUNKS:
            kept.append(view[at:end])
        if kind == b"IEND":
            break
        at = end
    width, height = struct.unpack_from(">II", header, 4)
    return ImageParts((width, height), b"".join(kept))


def _jpeg_parts(data: bytes) -> ImageParts:
    view = memoryview(data)
    kept = [view[:2]]
    size_px: tuple[int, int] | None = None
    scans = 0
    for marker, start, end in _jpeg_segments(data):
        if marker in _SOF:
            if size_px is not None:
                raise ValueError("the JPEG has two frame headers")
            height, width = struct.unpack_from(">HH", data, start + 5)
            size_px = width, height
        scans += marker == _SOS
        if scans > _MOST_SCANS:
            raise ValueError(f"the JPEG has more than {_MOST_SCANS} scans")
        if marker in _JPEG_PIXEL_SEGMENTS:
            kept.append(view[start:end])
    if size_px is None:
        raise ValueError("the JPEG has no frame header")
    return ImageParts(size_px, b"".join(kept))


def _jpeg_segments(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Marker, start and end of each segment; that of a scan has its data with it, the last one is EOI."""
    at = 2
    for _ in _counted(data):
        found = _NEXT_MARKER.search(data, at)  # past fill bytes, and what does not belong there
        if found is None:
            return
        start, marker = found.start(), data[found.end() - 1]
        if marker == _EOI:
            yield _EOI, start, start + 2
            return
        if start + 4 > len(data):
            return
        size = int.from_bytes(data[start + 2 : start + 4])
        if marker < _LEAST_MARKER or marker == _SOI or size < (8 if marker in _SOF else 2):
            raise ValueError(f"the JPEG has a damaged segment at byte {start}")
        end = start + 2 + size
        if end > len(data):
            return
        if marker == _SOS:
            following = _NEXT_MARKER.search(data, end)
            end = following.start() if following else len(data)
        yield marker, start, end
        at = end


def _counted(data: bytes) -> Iterator[int]:
    """Counts parts. Raises ValueError where there are too many for that much data."""
    most = _MOST_PARTS + len(data) // _BYTES_PER_FURTHER_PART
    yield from range(most)
    raise ValueError(f"the image has more than {most} parts")
