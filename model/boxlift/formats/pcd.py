"""The Point Cloud Library's .pcd: ascii, binary and binary_compressed.

Source of the format: "The PCD (Point Cloud Data) file format", pointclouds.org documentation, v0.7.
"""

from __future__ import annotations

import importlib
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boxlift.errors import MissingExtraError, PointCloudError
from boxlift.formats.cloud_limits import require_point_count
from boxlift.formats.number_lines import read_number_lines

_LARGEST_HEADER_BYTES = 65_536
# LZF packs at most 264 bytes into 3.
_LARGEST_LZF_RATIO = 88
_LARGEST_UNPACKED_BYTES = 2**28
_MOST_DIGITS = 18
_REMEDY = "Save the .pcd again (version 0.7 with the fields x y z)."


def decode_pcd(data: bytes, field: str, max_points: int | None = None) -> NDArray[Any]:
    """A .pcd file's bytes -> (N, 3) x, y, z, or (N, 4) where there is a field named intensity.

    Raises PointCloudError; other exceptions of NumPy may pass for malformed numbers.
    """
    header, body = _split_header(data, field)
    names = header.get("FIELDS", [])
    counts = [_whole_number(count) for count in header.get("COUNT", ["1"] * len(names))]
    kinds, sizes = header.get("TYPE", []), header.get("SIZE", [])
    if not len(names) == len(counts) == len(kinds) == len(sizes) or not all(0 < n <= 1000 for n in counts):
        raise PointCloudError(field, "FIELDS, SIZE, TYPE and COUNT of the .pcd do not agree.", _REMEDY)
    missing = [axis for axis in "xyz" if axis not in names]
    if missing:
        raise PointCloudError(
            field, f"the .pcd has the fields {names[:20]!s:.200}, without {missing}.", _REMEDY
        )
    columns = [names.index(name) for name in ("x", "y", "z", "intensity") if name in names]
    if any(counts[column] != 1 for column in columns):
        raise PointCloudError(field, "a coordinate of the .pcd has COUNT above 1.", _REMEDY)
    point_count = _point_count(header, field)
    require_point_count(point_count, max_points, field)
    encoding = header["DATA"][0] if header["DATA"] else ""
    if encoding == "ascii":
        starts = np.cumsum([0, *counts])
        return _read_ascii(body, point_count, [int(starts[column]) for column in columns], field)
    row = [
        (str(index), _number_type(kind, size, field), (count,) if count > 1 else ())
        for index, (kind, size, count) in enumerate(zip(kinds, sizes, counts, strict=True))
    ]
    dtype = np.dtype(row)
    if encoding == "binary":
        return _read_rows(body, point_count, dtype, columns, field)
    if encoding == "binary_compressed":
        return _read_compressed(body, point_count, dtype, columns, field)
    raise PointCloudError(
        field, f"the .pcd has DATA {encoding!r:.40}.", "Save it as ascii, binary or binary_compressed."
    )


def _split_header(data: bytes, field: str) -> tuple[dict[str, list[str]], bytes]:
    header: dict[str, list[str]] = {}
    position = 0
    while "DATA" not in header:
        end = data.find(b"\n", position, _LARGEST_HEADER_BYTES)
        if end < 0:
            raise PointCloudError(field, "the header of the .pcd has no line DATA.", _REMEDY)
        words = data[position:end].decode("latin-1").split()
        if words and not words[0].startswith("#"):
            header[words[0].upper()] = words[1:]
        position = end + 1
    return header, data[position:]


def _point_count(header: dict[str, list[str]], field: str) -> int:
    try:
        if "POINTS" in header:
            count = _whole_number(header["POINTS"][0])
        else:
            count = _whole_number(header["WIDTH"][0]) * _whole_number(header["HEIGHT"][0])
    except (KeyError, IndexError, ValueError):
        raise PointCloudError(field, "the .pcd does not say how many POINTS it has.", _REMEDY) from None
    if count < 0:
        raise PointCloudError(field, f"the .pcd says that it has {count} points.", _REMEDY)
    return count


def _whole_number(word: str) -> int:
    """Raises ValueError where it is none, or one of more digits than any count has."""
    if len(word) > _MOST_DIGITS:
        raise ValueError(f"{word[:20]!r}... is no count")
    return int(word)


def _number_type(kind: str, size: str, field: str) -> np.dtype[Any]:
    letter = {"F": "f", "I": "i", "U": "u"}.get(kind)
    if letter is None or size not in (("4", "8") if letter == "f" else ("1", "2", "4", "8")):
        raise PointCloudError(field, f"TYPE {kind!r:.20} of SIZE {size!r:.20} is none of .pcd's.", _REMEDY)
    return np.dtype(f"<{letter}{size}")


def _truncated(field: str, promised: int, found: str) -> PointCloudError:
    return PointCloudError(
        field,
        f"the .pcd promises {promised} points, {found}.",
        "The file is truncated or damaged; save it again.",
    )


def _read_ascii(body: bytes, point_count: int, columns: list[int], field: str) -> NDArray[Any]:
    if point_count * 6 > len(body) + 1:  # "0 0 0" and a line break
        raise _truncated(field, point_count, f"{len(body)} bytes follow")
    if point_count == 0:
        return np.empty((0, len(columns)))
    table = read_number_lines(body, point_count, columns)
    if len(table) != point_count:
        raise _truncated(field, point_count, f"{len(table)} lines follow")
    return table


def _read_rows(
    body: bytes, point_count: int, dtype: np.dtype[Any], columns: list[int], field: str
) -> NDArray[Any]:
    if point_count * dtype.itemsize > len(body):
        raise _truncated(field, point_count, f"{len(body)} bytes of {dtype.itemsize} each follow")
    rows = np.frombuffer(body, dtype, point_count)
    return np.stack([rows[str(column)] for column in columns], axis=1)


def _read_compressed(
    body: bytes, point_count: int, dtype: np.dtype[Any], columns: list[int], field: str
) -> NDArray[Any]:
    """LZF over the columns, one after the other."""
    if len(body) < 8:
        raise _truncated(field, point_count, f"{len(body)} bytes follow")
    packed_bytes, unpacked_bytes = struct.unpack_from("<II", body)
    packed = body[8 : 8 + packed_bytes]
    if (
        len(packed) != packed_bytes
        or unpacked_bytes != point_count * dtype.itemsize
        or unpacked_bytes > min(len(packed) * _LARGEST_LZF_RATIO, _LARGEST_UNPACKED_BYTES)
    ):
        raise _truncated(
            field,
            point_count,
            f"{len(packed)} compressed bytes of {packed_bytes} follow that would unpack to {unpacked_bytes}",
        )
    if point_count == 0:
        return np.empty((0, len(columns)))
    unpacked = _lzf().decompress(packed, unpacked_bytes)
    if unpacked is None or len(unpacked) != unpacked_bytes:
        raise _truncated(field, point_count, "the compressed data ends early")
    found = []
    for column in columns:
        number_type, offset = dtype.fields[str(column)][:2] if dtype.fields else (dtype, 0)
        found.append(np.frombuffer(unpacked, number_type, point_count, offset * point_count))
    return np.stack(found, axis=1)


def _lzf() -> Any:  # a C extension without types
    try:
        return importlib.import_module("lzf")
    except ModuleNotFoundError:
        raise MissingExtraError("python-neo-lzf", "label") from None
