"""Point clouds: KITTI .bin, NumPy .npy and .npz, .pcd and .ply.

All readers are NumPy on bytes that are checked first, so that a header that lies is an error and
neither a crash nor a huge allocation. The format is told by the first bytes (no LiDAR return spells
them); what has none of them is KITTI's .bin: float32 x, y, z, intensity. Archives but .npz are refused.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from boxlift.errors import MissingExtraError, PointCloudError
from boxlift.formats import archives
from boxlift.formats.cloud_limits import require_point_count
from boxlift.formats.numpy_files import NPY_MAGIC, decode_npy, decode_npz
from boxlift.formats.pcd import decode_pcd
from boxlift.formats.ply import decode_ply
from boxlift.storage import read_input

if TYPE_CHECKING:
    from boxlift.storage import AnyPath

SUFFIXES = (".bin", ".npy", ".npz", ".pcd", ".ply")

# No LiDAR measures 100 km: larger coordinates are fill values (1e30) or map coordinates (UTM).
_LARGEST_COORDINATE_M = 1e5
_KITTI_RETURN_BYTES = 16
_NPZ_MAGICS = (b"PK\x03\x04", b"PK\x05\x06")
_FORMATS_REMEDY = "Give KITTI .bin (float32 x y z intensity), .npy, .npz, .pcd or .ply."


_Decode = Callable[[bytes, str, int | None], NDArray[Any]]


@dataclass(frozen=True)
class DecodedPoints:
    """points: (N, 3+) float32 with N > 0, the first three columns x, y, z finite and in metres.

    dropped: number of returns that were left out, not finite or farther than 100 km on an axis.
    """

    points: NDArray[np.float32]
    dropped: int


def decode_points(
    data: bytes, name: str | None = None, field: str = "points", max_points: int | None = None
) -> DecodedPoints:
    """A point cloud file's bytes -> its finite points.

    `name` is the file's name where it has one, `field` what errors call the input. Raises
    PointCloudError where the data is of no known format, truncated, holds no finite point, or more than
    `max_points` points, finite or not.
    """
    if not data:
        raise PointCloudError(field, "the data is empty (0 bytes).", _FORMATS_REMEDY)
    decode = _decoder(data, name, field)
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # columns may hold anything
            return _finite(decode(data, field, max_points), field)
    except (PointCloudError, MissingExtraError, MemoryError):
        raise
    # Whatever else a malformed file provokes in array code is that file's fault.
    except Exception as error:
        raise PointCloudError(
            field, f"the data cannot be read ({type(error).__name__}: {error!s:.120}).", _FORMATS_REMEDY
        ) from None


def read_points(path: AnyPath) -> DecodedPoints:
    """decode_points for a file. Raises PointCloudError, also where the file cannot be opened."""
    return decode_points(read_input(path, PointCloudError), path.name, str(path))


def _decoder(data: bytes, name: str | None, field: str) -> _Decode:
    archive = archives.archive_kind(data)
    if archive is not None and not data.startswith(_NPZ_MAGICS):
        raise PointCloudError(field, f"the data is {archive}.", archives.REMEDY)
    for magics, suffix, decode in (
        ((NPY_MAGIC,), ".npy", decode_npy),
        (_NPZ_MAGICS, ".npz", decode_npz),
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


def _decode_kitti_bin(data: bytes, field: str, max_points: int | None) -> NDArray[Any]:
    if len(data) % _KITTI_RETURN_BYTES:
        raise PointCloudError(
            field,
            f"{len(data)} bytes are not a whole number of KITTI returns of {_KITTI_RETURN_BYTES} bytes; "
            "the file is truncated or of another format.",
            "Give float32 x, y, z, intensity for every return (other columns: save an .npy).",
        )
    require_point_count(len(data) // _KITTI_RETURN_BYTES, max_points, field)
    return np.frombuffer(data, "<f4").reshape(-1, 4)


def _finite(table: NDArray[Any], field: str) -> DecodedPoints:
    """Drop non-returns and convert to float32."""
    if len(table) == 0:
        raise PointCloudError(field, "there are 0 points.", "Give a cloud with at least one return.")
    # In float32: 100 km are beyond a float16, and the least integer has no absolute value.
    xyz = table[:, :3].astype(np.float32, copy=False)
    keep = (np.abs(xyz) <= _LARGEST_COORDINATE_M).all(axis=1)  # False for NaN
    kept = int(np.count_nonzero(keep))
    if kept == 0:
        raise PointCloudError(
            field,
            f"none of the {len(table)} points is finite and within 100 km.",
            "Give x, y, z in metres in the LiDAR's own frame.",
        )
    points = np.array(table if kept == len(table) else table[keep], dtype=np.float32, order="C")
    return DecodedPoints(points, len(table) - kept)
