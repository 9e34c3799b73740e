"""Stanford's .ply: the vertices of ascii and binary files.

Source of the format: Greg Turk, "The PLY Polygon File Format" (1994).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boxlift.errors import PointCloudError
from boxlift.formats.cloud_limits import require_point_count
from boxlift.formats.number_lines import read_number_lines

_LARGEST_HEADER_BYTES = 65_536
_BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_NUMBER_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2",
    "int": "i4", "uint": "u4", "float": "f4", "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8",
}  # fmt: skip
_REMEDY = "Save the .ply again, with a first element 'vertex' that has x, y and z."


@dataclass
class _Element:
    name: str
    count: int
    properties: list[tuple[str, str]] = field(default_factory=list)  # name and number type


def decode_ply(data: bytes, field: str, max_points: int | None = None) -> NDArray[Any]:
    """A .ply file's bytes -> (N, 3) x, y, z, or (N, 4) where there is a property named intensity.

    Raises PointCloudError; other exceptions of NumPy may pass for malformed numbers.
    """
    byte_order, vertex, body = _split_header(data, field)
    names = [name for name, _ in vertex.properties]
    missing = [axis for axis in "xyz" if axis not in names]
    if missing or len(set(names)) != len(names):
        raise PointCloudError(field, f"the vertices have the properties {names[:20]!s:.200}.", _REMEDY)
    wanted = [name for name in ("x", "y", "z", "intensity") if name in names]
    dtype = np.dtype([(name, byte_order + number_type) for name, number_type in vertex.properties])
    least_bytes = dtype.itemsize if byte_order else 2 * len(names)  # "0 0 0" and a line break
    if vertex.count * least_bytes > len(body) + 1:
        raise _truncated(field, vertex.count, f"{len(body)} bytes")
    require_point_count(vertex.count, max_points, field)
    if vertex.count == 0:
        return np.empty((0, len(wanted)))
    if byte_order:
        rows = np.frombuffer(body, dtype, vertex.count)
        return np.stack([rows[name] for name in wanted], axis=1)
    table = read_number_lines(body, vertex.count, [names.index(name) for name in wanted])
    if len(table) != vertex.count:
        raise _truncated(field, vertex.count, f"{len(table)} lines")
    return table


def _truncated(field: str, promised: int, found: str) -> PointCloudError:
    return PointCloudError(
        field,
        f"the .ply promises {promised} vertices, {found} follow.",
        "The file is truncated or damaged; save it again.",
    )


def _split_header(data: bytes, field: str) -> tuple[str, _Element, bytes]:
    """Byte order ("" for ascii), the first element, and the bytes after the header."""
    byte_order: str | None = None
    elements: list[_Element] = []
    position = 0
    while True:
        end = data.find(b"\n", position, _LARGEST_HEADER_BYTES)
        if end < 0:
            raise PointCloudError(field, "the header of the .ply has no line end_header.", _REMEDY)
        line = data[position:end].decode("latin-1").strip()
        position = end + 1
        match line.split():
            case ["end_header"]:
                break
            case ["format", encoding, _]:
                byte_order = _BYTE_ORDERS.get(encoding)
            case ["element", name, count] if count.isascii() and count.isdigit() and len(count) < 19:
                elements.append(_Element(name, int(count)))
            case ["property", number_type, name] if elements and number_type in _NUMBER_TYPES:
                elements[-1].properties.append((name, _NUMBER_TYPES[number_type]))
            case ["property", "list", *_] if elements and elements[-1].name != "vertex":
                pass  # faces, which follow the vertices and are not read
            case [] | ["ply"] | ["comment" | "obj_info", *_]:
                pass
            case _:
                raise PointCloudError(field, f"the header of the .ply has the line {line!r:.80}.", _REMEDY)
    if byte_order is None:
        raise PointCloudError(field, "the header of the .ply names no format that is known.", _REMEDY)
    if not elements or elements[0].name != "vertex":
        raise PointCloudError(field, "the first element of the .ply is not 'vertex'.", _REMEDY)
    return byte_order, elements[0], data[position:]
