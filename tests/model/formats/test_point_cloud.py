"""Point clouds: each format against its reference writer, and no input that does worse than an error."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from plyfile import PlyData, PlyElement
from pypcd4.pypcd4 import Encoding, PointCloud

from boxlift.errors import PointCloudError
from boxlift.formats.point_cloud import decode_points, read_points

POINTS = np.random.default_rng(0).uniform(-80, 80, (300, 4)).astype(np.float32)


def as_bin(points: NDArray[Any]) -> bytes:
    return points.tobytes()


def as_npy(points: NDArray[Any]) -> bytes:
    stream = io.BytesIO()
    np.save(stream, points)
    return stream.getvalue()


def as_npz(points: NDArray[Any]) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, points=points, other=np.zeros(3))
    return stream.getvalue()


def as_pcd(points: NDArray[Any], encoding: Encoding) -> bytes:
    stream = io.BytesIO()
    PointCloud.from_xyzi_points(points).save(stream, encoding=encoding)
    return stream.getvalue()


def as_ply(points: NDArray[Any], byte_order: str) -> bytes:
    rows = np.ascontiguousarray(points).view([(name, "f4") for name in ("x", "y", "z", "intensity")])[:, 0]
    faces = np.array([([0, 1, 2],)], dtype=[("vertex_indices", "i4", (3,))])
    elements = [PlyElement.describe(rows, "vertex"), PlyElement.describe(faces, "face")]
    stream = io.BytesIO()
    PlyData(elements, text=not byte_order, byte_order=byte_order or "=", comments=["made here"]).write(stream)
    return stream.getvalue()


WRITERS: dict[str, Callable[[NDArray[Any]], bytes]] = {
    "bin": as_bin,
    "npy": as_npy,
    "npz": as_npz,
    "pcd ascii": lambda points: as_pcd(points, Encoding.ASCII),
    "pcd binary": lambda points: as_pcd(points, Encoding.BINARY),
    "pcd compressed": lambda points: as_pcd(points, Encoding.BINARY_COMPRESSED),
    "ply ascii": lambda points: as_ply(points, ""),
    "ply little": lambda points: as_ply(points, "<"),
    "ply big": lambda points: as_ply(points, ">"),
}
VALID = {kind: write(POINTS[:40]) for kind, write in WRITERS.items()}


@pytest.mark.parametrize("kind", WRITERS)
def test_round_trip(kind: str) -> None:
    decoded = decode_points(WRITERS[kind](POINTS))
    np.testing.assert_allclose(decoded.points, POINTS, rtol=1e-6)
    assert decoded.points.dtype == np.float32
    assert decoded.points.flags.writeable  # torch warns of arrays that are not
    assert decoded.dropped == 0


@pytest.mark.parametrize("kind", WRITERS)
def test_returns_that_are_none_are_dropped_and_counted(kind: str) -> None:
    points = POINTS.copy()
    points[[3, 50], 1] = np.nan, np.inf
    points[7, 0] = 1e30
    decoded = decode_points(WRITERS[kind](points))
    assert decoded.dropped == 3
    np.testing.assert_allclose(decoded.points, np.delete(POINTS, [3, 7, 50], axis=0), rtol=1e-6)


@pytest.mark.parametrize("kind", WRITERS)
def test_clouds_without_a_finite_point_are_refused(kind: str) -> None:
    with pytest.raises(PointCloudError, match="none of the 20 points is finite"):
        decode_points(WRITERS[kind](np.full((20, 4), np.nan, dtype=np.float32)))


@pytest.mark.parametrize("kind", sorted(set(WRITERS) - {"bin"}))
def test_clouds_without_points_are_refused(kind: str) -> None:
    with pytest.raises(PointCloudError, match="0 points"):
        decode_points(WRITERS[kind](POINTS[:0]))


@pytest.mark.parametrize("kind", WRITERS)
def test_truncated_files_are_refused(kind: str) -> None:
    data = VALID[kind] if not kind.startswith("ply") else VALID[kind].replace(b"element face 1", b"")
    with pytest.raises(PointCloudError):
        decode_points(data[: len(data) // 2 + 1])


def test_truncated_bin_names_its_size_and_the_remedy() -> None:
    with pytest.raises(PointCloudError) as caught:
        decode_points(POINTS.tobytes()[:-5], "000001.bin")
    assert caught.value.field == "points"
    assert str(POINTS.nbytes - 5) in caught.value.problem
    assert "float32" in caught.value.remedy


@pytest.mark.parametrize("dtype", ["<f8", ">f4", "i2"])
def test_npy_of_other_number_types_and_orders(dtype: str) -> None:
    decoded = decode_points(as_npy(np.asfortranarray(np.arange(60).reshape(12, 5).astype(dtype))))
    np.testing.assert_array_equal(decoded.points, np.arange(60).reshape(12, 5))


def test_npy_of_huge_doubles_does_not_overflow() -> None:
    decoded = decode_points(as_npy(np.array([[1e300, 0, 0, 0], [1, 2, 3, 1e300]])))
    assert decoded.dropped == 1
    np.testing.assert_array_equal(decoded.points[:, :3], [[1, 2, 3]])


def test_npz_with_one_array_of_any_name() -> None:
    stream = io.BytesIO()
    np.savez(stream, POINTS)
    np.testing.assert_array_equal(decode_points(stream.getvalue()).points, POINTS)


def npy(header: str, body: bytes = bytes(24)) -> bytes:
    """An .npy file with any header."""
    text = header.ljust(118 - 1).encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + body


def npz_of_zeros(megabytes: int) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("a.npy", "w") as member:
        for _ in range(megabytes):
            member.write(bytes(2**20))
    return stream.getvalue()


def pcd(data: str, body: bytes = bytes(24), points: object = 2, fields: str = "x y z") -> bytes:
    """A .pcd file with any header."""
    sizes = f"FIELDS {fields}\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
    return f"VERSION 0.7\n{sizes}WIDTH {points}\nHEIGHT 1\nPOINTS {points}\n{data}\n".encode() + body


def ply(kind: str, body: bytes = b"", points: int = 1, more: str = "") -> bytes:
    """A .ply file with any header."""
    head = f"ply\nformat {kind} 1.0\nelement vertex {points}\n"
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    return f"{head}{axes}{more}end_header\n".encode() + body


FLOATS = "'descr': '<f4', 'fortran_order': False, 'shape': "


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "empty"),
        (b"x,y,z\n1,2,3\n4,5,6\n", "text"),
        (b"not a cloud at all, but 32 bytes", "text"),
        (as_npy(np.zeros((4, 2))), "(4, 2)"),
        (as_npy(np.zeros(9)), "(9,)"),
        (as_npy(np.array([["a"] * 3])), "not numbers"),
        (as_npy(np.zeros((4, 3), dtype=complex)), "not numbers"),
        (npy("{'descr': '|O', 'fortran_order': False, 'shape': (1, 3)}"), "not numbers"),
        (npy(f"{{{FLOATS}(10000000000, 3)}}"), "24 bytes"),
        (npy(f"{{{FLOATS}(-1, 3)}}"), "shape (-1, 3)"),
        (npy("(" * 100), "not that of an array of numbers"),
        (npz_of_zeros(300), "unpacks to 314572800 bytes"),
        (pcd("DATA binary", points=10**12), "promises 1000000000000 points"),
        (pcd("DATA ascii", b"1 2 3\n", points=10**12), "promises 1000000000000 points"),
        (pcd("DATA ascii", b"1 2 x\n", points=1), "cannot be read"),
        (pcd("DATA binary_compressed", b"\xff" * 40), "promises 2 points"),
        (pcd("DATA secret"), "secret"),
        (pcd("", b""), "no line DATA"),
        (pcd("DATA ascii", fields="x y"), "do not agree"),
        (pcd("DATA ascii", fields="r g b"), "without ['x', 'y', 'z']"),
        (pcd("DATA ascii", points="many"), "how many POINTS"),
        (pcd("DATA ascii", points=-4), "-4 points"),
        (ply("ascii", b"1 2 3\n", points=10**15), "promises"),
        (ply("binary_little_endian", points=10**15), "promises"),
        (ply("ascii", b"1 2 3 \n   4 5     6\n", points=3), "2 lines"),
        (ply("cuneiform", bytes(12)), "no format"),
        (b"ply\nformat ascii 1.0\n" + b"x" * 10**6, "end_header"),
        (b"ply\nformat ascii 1.0\nend_header\n", "not 'vertex'"),
        (ply("ascii", more="property list uchar int a\n"), "property list"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_malformed_clouds_are_refused(data: bytes, says: str) -> None:
    with pytest.raises(PointCloudError) as caught:
        decode_points(data)
    assert caught.value.field == "points"
    assert says in caught.value.problem + caught.value.remedy
    assert caught.value.remedy


@pytest.mark.parametrize("name", ["cloud.ply", "cloud.NPY", "a.b.pcd"])
def test_names_that_promise_another_format(name: str) -> None:
    with pytest.raises(PointCloudError, match="does not begin like"):
        decode_points(POINTS.tobytes(), name)


def decode_or_refuse(data: bytes) -> None:
    try:
        decoded = decode_points(data)
    except PointCloudError:
        return
    assert np.isfinite(decoded.points[:, :3]).all()
    assert len(decoded.points)


@given(st.binary(max_size=400))
@settings(max_examples=200, deadline=None)
def test_random_bytes(data: bytes) -> None:
    decode_or_refuse(data)


@given(st.sampled_from(sorted(VALID)), st.data())
@settings(max_examples=400, deadline=None)
def test_mutated_files(kind: str, draw: st.DataObject) -> None:
    data = bytearray(VALID[kind])
    reach = draw.draw(st.sampled_from([60, 300, len(data)]))  # headers are where the lies are
    for _ in range(draw.draw(st.integers(1, 4))):
        at = draw.draw(st.integers(0, min(reach, len(data)) - 1))
        data[at : at + draw.draw(st.integers(0, 3))] = draw.draw(st.binary(max_size=4))
    decode_or_refuse(
        bytes(data[: draw.draw(st.integers(0, len(data)))] if draw.draw(st.booleans()) else data)
    )


def test_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(PointCloudError, match=r"absent\.bin"):
        read_points(tmp_path / "absent.bin")


def test_real_frames(kitti_object_root: Path) -> None:
    path = sorted((kitti_object_root / "training" / "velodyne").iterdir())[0]
    decoded = read_points(path)
    assert decoded.points.shape == (path.stat().st_size // 16, 4)
    assert decoded.dropped == 0


@pytest.mark.parametrize("kind", WRITERS)
def test_limit_of_points(kind: str) -> None:
    data = WRITERS[kind](np.concatenate([POINTS[:9], np.full((1, 4), np.nan, np.float32)]))
    assert decode_points(data, max_points=10).dropped == 1
    with pytest.raises(PointCloudError, match=r"there are 10 points\. Give at most 9"):
        decode_points(data, max_points=9)
