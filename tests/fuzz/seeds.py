"""Valid files of every format, small and of many kinds: what the fuzzer damages."""

from __future__ import annotations

import io
import json
import struct
import zipfile
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.PngImagePlugin import PngInfo

_LZF: Any = import_module("lzf")  # a C extension without types
_POINTS = np.random.default_rng(5).uniform(-60, 60, (12, 4)).round(3).astype(np.float32)
_AXES = ("x", "y", "z", "intensity")
_P2: list[list[float]] = [[700.0, 0, 600, 45.5], [0, 700, 180, -0.5], [0, 0, 1, 0.005]]
_CAM_T_VELO: list[list[float]] = [[0.0, -1, 0, 0], [0, 0, -1, -0.08], [1, 0, 0, -0.27], [0, 0, 0, 1]]
_ROTATION: list[list[float]] = [[1.0, 0, 0], [0, 1, 0], [0, 0, 1]]
_CAR = {"class": "Car", "box": [540, 180.5, 660, 260], "score": 0.9}
_CYCLIST = {"class": "Cyclist", "box": [1, 2, 3, 4]}


def kitti_bin() -> tuple[bytes, ...]:
    """Clouds as KITTI has them; one with returns that are none."""
    holed = _POINTS.copy()
    holed[2, 1], holed[3, 0], holed[4, 2] = np.nan, np.inf, 1e30
    return _POINTS.tobytes(), _POINTS[:1].tobytes(), holed.tobytes()


def npy() -> tuple[bytes, ...]:
    """Arrays of several types, orders and versions of the format."""
    arrays: list[NDArray[Any]] = [
        _POINTS,
        np.asfortranarray(_POINTS.astype(">f8")),
        _POINTS.astype("i4"),
        _POINTS.astype("f2"),
        np.pad(_POINTS, ((0, 0), (0, 3))),
    ]
    return *(_npy(array) for array in arrays), _npy(_POINTS, (2, 0)), _npy(_POINTS, (3, 0))


def npz() -> tuple[bytes, ...]:
    """Archives of one array and of several, stored and deflated."""
    two, one, stored = io.BytesIO(), io.BytesIO(), io.BytesIO()
    np.savez_compressed(two, points=_POINTS, other=np.zeros(3))
    np.savez_compressed(one, _POINTS.astype("f8"))
    np.savez(stored, points=_POINTS)
    return two.getvalue(), one.getvalue(), stored.getvalue()


def npz_of(members: list[tuple[str, bytes]], deflated: bool = True) -> bytes:
    """An archive of any members."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED if deflated else zipfile.ZIP_STORED) as archive:
        for name, data in members:
            archive.writestr(zipfile.ZipInfo(name, (2020, 1, 1, 0, 0, 0)), data)
    return stream.getvalue()


def lzf_of(data: bytes) -> bytes:
    """LZF of any bytes; of those that it would not make smaller, in runs of 32."""
    runs = (data[at : at + 32] for at in range(0, len(data), 32))
    packed: bytes | None = _LZF.compress(data) if data else None
    return packed or b"".join(bytes([len(run) - 1]) + run for run in runs)


def lzf_unpacked(data: bytes, most_bytes: int) -> bytes:
    """What LZF holds; b"" where it is damaged or more than that."""
    try:
        return _LZF.decompress(data, most_bytes) or b""
    except ValueError:
        return b""


def pcd(encoding: str) -> tuple[bytes, ...]:
    """x y z intensity, and a file with other fields between them."""
    mixed = np.zeros(12, [("rgb", "<u4"), ("x", "<f8"), ("y", "<f4"), ("n", "<i2", 3), ("z", "<f4")])
    for name in "xyz":
        mixed[name] = _POINTS[:, "xyz".index(name)]
    plain = _POINTS.view([(name, "<f4") for name in _AXES])[:, 0]
    return _pcd(plain, encoding, "# .PCD v0.7\n"), _pcd(mixed, encoding, "")


def ply(encoding: str) -> tuple[bytes, ...]:
    """Vertices alone, and with a colour, comments and faces."""
    order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[encoding]
    floats = "".join(f"property float {name}\n" for name in _AXES)
    plain = _ply(encoding, floats, b"", _POINTS[:, :4], order + "f4", order)
    doubles = "".join(f"property double {name}\n" for name in "xyz") + "property double q\n"
    faces = b"3 0 1 2\n" if encoding == "ascii" else b"\x03" + struct.pack(f"{order}3i", 0, 1, 2)
    more = doubles + "element face 1\nproperty list uchar int vertex_indices\n"
    return plain, _ply(encoding, more, faces, _POINTS, order + "f8", order)


def calibration_text() -> tuple[bytes, ...]:
    """The spellings of KITTI's object, tracking and raw data."""
    projection = " ".join(f"{n:.6e}" for row in _P2 for n in row)
    rotation = " ".join(f"{n:g}" for row in _ROTATION for n in row)
    velo_to_cam = " ".join(f"{n:g}" for row in _CAM_T_VELO[:3] for n in row)
    return (
        f"P0: {projection}\nP2: {projection}\nR0_rect: {rotation}\nTr_velo_to_cam: {velo_to_cam}\n".encode(),
        f"P2: {projection}\nR_rect {rotation}\nTr_velo_cam {velo_to_cam}\n".encode(),
        f"calib_time: 09-Jan-2012\nP_rect_02: {projection}\nR_rect_00: {rotation}\r\n"
        f"Tr_velo_to_cam: {velo_to_cam}\n".encode(),
    )


def calibration_json() -> tuple[bytes, ...]:
    """One matrix for the LiDAR, and two."""
    tr = _CAM_T_VELO[:3]
    return (
        _json({"P2": _P2, "cam_T_velo": _CAM_T_VELO, "image_size": [1242, 375]}),
        _json({"P2": _P2, "R0_rect": _ROTATION, "Tr_velo_to_cam": tr}),
    )


def camera_config() -> tuple[bytes, ...]:
    """Cameras of Xtreme1 in both spellings, and column by column."""
    internal = {"fx": 700.0, "fy": 700, "cx": 600, "cy": 180}
    rows = [n for row in _CAM_T_VELO for n in row]
    columns = [row[column] for column in range(4) for row in _CAM_T_VELO]
    old = {"camera_internal": internal, "camera_external": rows, "width": 1242, "height": 375}
    new = {"cameraInternal": internal, "cameraExternal": columns, "rowMajor": False}
    return _json([old, {}]), _json(new), _json([new, old])


def prompts() -> tuple[bytes, ...]:
    """Lists of none, one and two prompts."""
    return _json([_CAR, _CYCLIST]), _json([_CAR]), b"[]"


def prompt_lists() -> tuple[bytes, ...]:
    """Lists for two images."""
    return _json([[_CAR], []]), _json([[_CYCLIST, _CAR], [_CAR]])


def options() -> tuple[bytes, ...]:
    """Settings of several groups, and a class with its size."""
    tram = {"height_m": 3.6, "width_m": 2.4, "length_m": 30.0, "source": "data sheet"}
    return (
        b"{}",
        _json({"repairs": {"size": "fixed"}, "ground": {"remove": False, "cell_m": 1.5}}),
        _json({"sizes": {"Tram": tram}, "points": {"min_points": 7}}),
    )


def size_priors() -> tuple[bytes, ...]:
    """A class, and one with templates."""
    sizes = "height_m = 3.6\nwidth_m = 2.4\nlength_m = 30.0\nsource = 'sheet'\n"
    return (
        f"[Tram]\n{sizes}".encode(),
        f"[Car]\n{sizes}spread = [0.1, 0.1, 0.2]\n[[Car.templates]]\nname = 'a'\n{sizes}".encode(),
    )


def png() -> tuple[bytes, ...]:
    """Colour, grey, palette, alpha, interlaced by another hand, with text, profile and frames (APNG)."""
    picture = Image.fromarray((np.indices((9, 13)).sum(axis=0)[..., None] * (5, 7, 9)).astype(np.uint8))
    notes = PngInfo()
    notes.add_text("Title", "made here")
    notes.add_text("Note", "made here " * 20, zip=True)
    notes.add_itxt("Long", "made here", "en", "Long", zip=True)
    return (
        _encoded(picture, "PNG", pnginfo=notes, icc_profile=bytes(200), dpi=(72, 72)),
        *(_encoded(picture.convert(mode), "PNG") for mode in ("L", "P", "RGBA", "1", "LA")),
        _encoded(picture, "PNG", save_all=True, append_images=[picture.rotate(180)], duration=40),
    )


def jpeg() -> tuple[bytes, ...]:
    """Baseline, progressive, grey, CMYK, with restarts, Exif and a profile."""
    picture = Image.fromarray((np.indices((24, 40)).sum(axis=0)[..., None] * (2, 3, 4)).astype(np.uint8))
    exif = Image.Exif()
    exif[0x0112], exif[0x011A], exif[0x010F] = 6, 72.0, "maker"
    return (
        _encoded(picture, "JPEG"),
        _encoded(picture, "JPEG", progressive=True, comment=b"made here"),
        _encoded(picture.convert("L"), "JPEG"),
        _encoded(picture.convert("CMYK"), "JPEG"),
        _encoded(picture, "JPEG", exif=exif.tobytes(), icc_profile=bytes(300), restart_marker_rows=1),
        _encoded(picture, "MPO", save_all=True, append_images=[picture.rotate(180)]),
    )


def masks() -> tuple[bytes, ...]:
    """Masks of 16 and 8 bits, and of a palette."""
    ids = (np.indices((9, 13)).sum(axis=0) % 4).astype(np.uint16)
    palette = Image.fromarray(ids.astype(np.uint8)).convert("P")
    grey = Image.fromarray(ids.astype(np.uint8))
    return _encoded(Image.fromarray(ids), "PNG"), _encoded(grey, "PNG"), _encoded(palette, "PNG")


def _npy(array: NDArray[Any], version: tuple[int, int] | None = None) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, array, version)
    return stream.getvalue()


def _json(value: object) -> bytes:
    return json.dumps(value).encode()


def _pcd(rows: NDArray[Any], encoding: str, first_line: str) -> bytes:
    types = {name: rows.dtype[name].base for name in rows.dtype.names or ()}
    counts = {name: rows.dtype[name].shape[0] if rows.dtype[name].shape else 1 for name in types}
    letters = {"f": "F", "i": "I", "u": "U"}
    head = (
        f"{first_line}VERSION 0.7\nFIELDS {' '.join(types)}\n"
        f"SIZE {' '.join(str(kind.itemsize) for kind in types.values())}\n"
        f"TYPE {' '.join(letters[kind.kind] for kind in types.values())}\n"
        f"COUNT {' '.join(map(str, counts.values()))}\n"
        f"WIDTH {len(rows)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(rows)}\nDATA {encoding}\n"
    ).encode()
    if encoding == "ascii":
        lines = (" ".join(f"{n:g}" for field in row for n in np.ravel(field)) for row in rows.tolist())
        return head + "\n".join(lines).encode() + b"\n"
    if encoding == "binary":
        return head + rows.tobytes()
    columns = b"".join(np.ascontiguousarray(rows[name]).tobytes() for name in types)
    packed = lzf_of(columns)
    return head + struct.pack("<II", len(packed), len(columns)) + packed


def _ply(encoding: str, head: str, after: bytes, points: NDArray[Any], dtype: str, order: str) -> bytes:
    start = f"ply\nformat {encoding} 1.0\ncomment made here\nelement vertex {len(points)}\n{head}end_header\n"
    if not order:
        return start.encode() + "".join(f"{x} {y} {z} {w}\n" for x, y, z, w in points).encode() + after
    return start.encode() + points.astype(dtype).tobytes() + after


def _encoded(picture: Image.Image, kind: str, **how: Any) -> bytes:
    stream = io.BytesIO()
    picture.save(stream, kind, **how)
    return stream.getvalue()
