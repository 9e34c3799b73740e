"""Point clouds: KITTI .bin, NumPy .npy and .npz, .pcd and .ply.

All readers are NumPy on bytes that are checked first, so that a header that lies is an error and
neither a crash nor a huge allocation. The format is told by the first bytes (no LiDAR return spells
them); what has none of them is KITTI's .bin: float32 x, y, z, intensity.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boxlift.errors import MissingExtraError, PointCloudError
from boxlift.formats.pcd import decode_pcd
from boxlift.formats.ply import decode_ply

SUFFIXES = (".bin", ".npy", ".npz", ".pcd", ".ply")

# No LiDAR measures 100 km: larger coordinates are fill values (1e30) or map coordinates (UTM).
_LARGEST_COORDINATE_M = 1e5
# Most that a compressed file may unpack to: 16 million returns of x, y, z, intensity.
_LARGEST_UNPACKED_BYTES = 2**28
_KITTI_RETURN_BYTES = 16
_FORMATS_REMEDY = "Give KITTI .bin (float32 x y z intensity), .npy, .npz, .pcd or .ply."


@dataclass(frozen=True)
class DecodedPoints:
    """points: (N, 3+) float32 with N > 0, the first three columns x, y, z finite and in metres.

    dropped: number of returns that were left out, not finite or farther than 100 km on an axis.
    """

    points: NDArray[np.float32]
    dropped: int


def decode_points(data: bytes, name: str | None = None, field: str = "points") -> DecodedPoints:
    """A point cloud file's bytes -> its finite points.

    `name` is the file's name where it has one, `field` what errors call the input. Raises
    PointCloudError where the data is of no known format, truncated, or holds no finite point.
    """
    if not data:
        raise PointCloudError(field, "the data is empty (0 bytes).", _FORMATS_REMEDY)
    decode = _decoder(data, name, field)
    try:
        table = decode(data, field)
    except (PointCloudError, MissingExtraError):
        raise
    # Whatever else a malformed file provokes in zip, AST or array code is that file's fault.
    except Exception as error:
        raise PointCloudError(
            field, f"the data cannot be read ({type(error).__name__}: {error!s:.120}).", _FORMATS_REMEDY
        ) from None
    return _finite(table, field)


def read_points(path: Path) -> DecodedPoints:
    """decode_points for a file. Raises PointCloudError, also where the file cannot be opened."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise PointCloudError(
            str(path), f"the file cannot be read ({error.strerror}).", "Check the path."
        ) from None
    return decode_points(data, path.name, str(path))


def _decoder(data: bytes, name: str | None, field: str) -> Callable[[bytes, str], NDArray[Any]]:
    for magics, suffix, decode in (
        ((b"\x93NUMPY",), ".npy", _decode_npy),
        ((b"PK\x03\x04", b"PK\x05\x06"), ".npz", _decode_npz),
        ((b"# .PCD", b"VERSION", b"FIELDS"), ".pcd", decode_pcd),
        ((b"ply\n", b"ply\r"), ".ply", decode_ply),
    ):
        if data.startswith(magics):
            return decode
        if name is not None and name.lower().endswith(suffix):
            raise PointCloudError(
                field, f"{name!r} does not begin like a {suffix} file ({data[:8]!r}).", _FORMATS_REMEDY
            )
    if all(byte in b"\t\n\r" or 32 <= byte < 127 for byte in data[:256]):
        raise PointCloudError(field, f"the data is text ({data[:40]!r}).", _FORMATS_REMEDY)
    return _decode_kitti_bin


def _decode_kitti_bin(data: bytes, field: str) -> NDArray[Any]:
    if len(data) % _KITTI_RETURN_BYTES:
        raise PointCloudError(
            field,
            f"{len(data)} bytes are not a whole number of KITTI returns of {_KITTI_RETURN_BYTES} bytes; "
            "the file is truncated or of another format.",
            "Give float32 x, y, z, intensity for every return (other columns: save an .npy).",
        )
    return np.frombuffer(data, "<f4").reshape(-1, 4)


def _decode_npy(data: bytes, field: str) -> NDArray[Any]:
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    read_header = (
        np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    )
    shape, fortran_order, dtype = read_header(stream)
    if dtype.kind not in "fiu":
        raise PointCloudError(field, f"the array holds {dtype}, not numbers.", "Save an (N, 3+) float array.")
    if len(shape) != 2 or not 3 <= shape[1] <= 1000:
        raise PointCloudError(field, f"the array has shape {shape}.", "Save an (N, 3+) float array.")
    body = memoryview(data)[stream.tell() :]
    if len(body) != shape[0] * shape[1] * dtype.itemsize:
        raise PointCloudError(
            field,
            f"the header promises shape {shape} of {dtype}, {len(body)} bytes follow.",
            "The file is truncated or damaged; save it again.",
        )
    return np.frombuffer(body, dtype).reshape(shape, order="F" if fortran_order else "C")


def _decode_npz(data: bytes, field: str) -> NDArray[Any]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
        if "points" not in members and len(members) != 1:
            raise PointCloudError(
                field,
                f"the .npz holds the arrays {sorted(members)[:10]}.",
                "Save one array, or name one of them 'points'.",
            )
        member = members.get("points") or next(iter(members.values()))
        if member.file_size > _LARGEST_UNPACKED_BYTES:
            raise PointCloudError(
                field,
                f"{member.filename!r} unpacks to {member.file_size} bytes.",
                f"At most {_LARGEST_UNPACKED_BYTES} are read.",
            )
        return _decode_npy(archive.read(member), field)


def _finite(table: NDArray[Any], field: str) -> DecodedPoints:
    """Drop non-returns and convert to float32."""
    if len(table) == 0:
        raise PointCloudError(field, "there are 0 points.", "Give a cloud with at least one return.")
    keep = (np.abs(table[:, :3]) <= _LARGEST_COORDINATE_M).all(axis=1)  # False for NaN
    kept = int(np.count_nonzero(keep))
    if kept == 0:
        raise PointCloudError(
            field,
            f"none of the {len(table)} points is finite and within 100 km.",
            "Give x, y, z in metres in the LiDAR's own frame.",
        )
    with np.errstate(over="ignore"):  # further columns may hold anything
        points = np.array(table if kept == len(table) else table[keep], dtype=np.float32, order="C")
    return DecodedPoints(points, len(table) - kept)
