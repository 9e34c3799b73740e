"""NumPy's .npy and .npz, without pickles, without evaluating headers and without trust in sizes.

Source of the format: NumPy Enhancement Proposal 1, "A simple file format for NumPy arrays".
"""

from __future__ import annotations

import io
import re
import zipfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boxlift.errors import PointCloudError
from boxlift.formats.cloud_limits import require_point_count

NPY_MAGIC = b"\x93NUMPY"

# Most that an array of an .npz may unpack to: 16 million returns of x, y, z, intensity.
_LARGEST_UNPACKED_BYTES = 2**28
_LARGEST_HEADER_BYTES = 10_000
_MOST_COLUMNS = 1000
_MOST_MEMBERS = 1000
_ENCRYPTED = 0x1
_TYPE = re.compile(r"""["']descr["']\s*:\s*["']([<>|=]?[a-zA-Z?]\d*)["']""")
_ORDER = re.compile(r"""["']fortran_order["']\s*:\s*(True|False)""")
_SHAPE = re.compile(r"""["']shape["']\s*:\s*(\([-\dL, ]*\))""")
# Python 2 wrote some sizes as 12L.
_ROWS_AND_COLUMNS = re.compile(r"\((\d{1,18})L?, *(\d{1,4})L?,? *\)", re.ASCII)
_REMEDY = "Save an (N, 3+) float array."


def decode_npy(data: bytes, field: str, max_points: int | None = None) -> NDArray[Any]:
    """An .npy file's bytes -> its (N, 3+) array of numbers. Raises PointCloudError."""
    header, body = _split_header(data, field)
    type_name, order, shape_text = (pattern.search(header) for pattern in (_TYPE, _ORDER, _SHAPE))
    if not (type_name and order and shape_text):
        raise PointCloudError(
            field, f"the header of the .npy is {header!r:.120}, not that of an array of numbers.", _REMEDY
        )
    if not re.fullmatch("[<>|=]?([iu][1248]|f[248])", type_name[1]):
        raise PointCloudError(field, f"the array holds {type_name[1]:.20}, not numbers.", _REMEDY)
    sizes = _ROWS_AND_COLUMNS.fullmatch(shape_text[1])
    if sizes is None or not 3 <= int(sizes[2]) <= _MOST_COLUMNS:
        raise PointCloudError(field, f"the array has shape {shape_text[1]:.60}.", _REMEDY)
    shape = int(sizes[1]), int(sizes[2])
    dtype = np.dtype(type_name[1])
    if len(body) != shape[0] * shape[1] * dtype.itemsize:
        raise PointCloudError(
            field,
            f"the header promises shape {shape} of {dtype}, {len(body)} bytes follow.",
            "The file is truncated or damaged; save it again.",
        )
    require_point_count(shape[0], max_points, field)
    return np.frombuffer(body, dtype).reshape(shape, order="F" if order[1] == "True" else "C")


def decode_npz(data: bytes, field: str, max_points: int | None = None) -> NDArray[Any]:
    """An .npz file's bytes -> its array named points, or its only one. Raises PointCloudError."""
    # zipfile makes an object of each entry: of a million in one body.
    if data.count(b"PK\x01\x02") > _MOST_MEMBERS:
        raise PointCloudError(
            field,
            f"the data is a .zip archive of more than {_MOST_MEMBERS} files.",
            "Save the points as an .npz of one array.",
        )
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            member = _chosen(archive.infolist(), field)
            with archive.open(member) as stream:
                # Not all there is: the promised size may be a lie, and zlib makes a thousand bytes of one.
                array = stream.read(member.file_size + 1)
    except PointCloudError:
        raise
    # Damaged archives surface as BadZipFile, zlib.error, EOFError, struct.error, ValueError, ...
    except Exception as error:
        raise PointCloudError(
            field, f"the data is a damaged .zip archive ({error!s:.120}).", "Save the points again."
        ) from None
    if len(array) != member.file_size or not array.startswith(NPY_MAGIC):
        raise PointCloudError(
            field,
            f"the data is a .zip archive whose {member.filename!r:.60} holds no array.",
            "Save the points by np.savez.",
        )
    return decode_npy(array, field, max_points)


def _chosen(members: list[zipfile.ZipInfo], field: str) -> zipfile.ZipInfo:
    """The member to read; it is safe to read as much of it as it says that there is."""
    names = [member.filename for member in members]
    others = [name for name in names if not name.endswith(".npy")]
    if others or not names:
        raise PointCloudError(
            field,
            f"the data is a .zip archive and no .npz: it holds {others[:5]!s:.200}.",
            "Unpack it, and give the file that is in it.",
        )
    if "points.npy" not in names and len(names) > 1:
        raise PointCloudError(
            field,
            f"the .npz holds the arrays {sorted(names)[:10]!s:.200}.",
            "Save one array, or name one of them 'points'.",
        )
    chosen = [member for member in members if member.filename == "points.npy"] or members
    member = chosen[0]
    if len(chosen) > 1:
        raise PointCloudError(field, f"the .npz holds {len(chosen)} arrays 'points'.", "Save one.")
    if member.flag_bits & _ENCRYPTED:
        raise PointCloudError(field, "the data is an encrypted .zip archive.", "Save it without a password.")
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise PointCloudError(
            field,
            f"{member.filename!r:.60} is packed by method {member.compress_type} of .zip.",
            "Save it by np.savez or np.savez_compressed.",
        )
    if member.file_size > _LARGEST_UNPACKED_BYTES:
        raise PointCloudError(
            field,
            f"{member.filename!r:.60} unpacks to {member.file_size} bytes.",
            f"At most {_LARGEST_UNPACKED_BYTES} are read.",
        )
    return member


def _split_header(data: bytes, field: str) -> tuple[str, memoryview]:
    """The header's text and the bytes after it."""
    size_bytes = 2 if data[6:7] == b"\x01" else 4
    start = 8 + size_bytes
    end = start + int.from_bytes(data[8:start], "little")
    if end - start > _LARGEST_HEADER_BYTES or end > len(data):
        raise PointCloudError(
            field,
            f"the header of the .npy would have {end - start} bytes.",
            "The file is truncated or damaged; save it again.",
        )
    return data[start:end].decode("latin-1"), memoryview(data)[end:]
