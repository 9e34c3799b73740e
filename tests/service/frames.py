"""A small frame made by hand, as the fields of a form."""

from __future__ import annotations

import io
import json
import struct
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

WIDTH, HEIGHT = 1200, 360
P2 = [[700.0, 0, 600, 0], [0, 700, 180, 0], [0, 0, 1, 0]]
CAM_T_VELO = [[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]
CAR = {"class": "Car", "box": [540, 180, 660, 260], "score": 0.9}

Fields = dict[str, tuple[str | None, bytes]]
# As Fields, where a field may come several times.
Parts = list[tuple[str, tuple[str | None, bytes]]]


@dataclass(frozen=True)
class SmallFrame:
    """A road, and of a car 15 m ahead its back and right side; LiDAR frame, metres."""

    points_velo: NDArray[np.float32]

    def fields(self, **changes: bytes | None) -> Fields:
        """The form of POST /label with `changes` laid over it; None leaves a field out."""
        fields: dict[str, bytes | None] = {
            "points": kitti_bin(self.points_velo),
            "calib": calib_json(),
            "prompts": json.dumps([CAR]).encode(),
            **changes,
        }
        return {
            name: ("small.bin" if name == "points" else None, data)
            for name, data in fields.items()
            if data is not None
        }


def detect_parts(*images: bytes, calib: bytes | None = None, **texts: bytes) -> Parts:
    """The form of POST /detect; images are named 0.png, 1.png, ..."""
    parts: Parts = [("image", (f"{index}.png", image)) for index, image in enumerate(images)]
    parts.append(("calib", (None, calib_json() if calib is None else calib)))
    return [*parts, *((name, (None, data)) for name, data in texts.items())]


def grey_png(value: int = 128, width: int = WIDTH, height: int = HEIGHT) -> bytes:
    """An image of one colour."""
    return png(np.full((height, width, 3), value, np.uint8))


def small_frame() -> SmallFrame:
    rng = np.random.default_rng(7)
    ground_x, ground_y = np.meshgrid(np.linspace(5, 40, 60), np.linspace(-10, 10, 40))
    ground = np.stack([ground_x, ground_y, np.full_like(ground_x, -1.7)], axis=-1)
    across, up = np.meshgrid(np.linspace(-0.9, 0.9, 12), np.linspace(-1.4, -0.2, 10))
    back = np.stack([np.full_like(across, 15.0), across, up], axis=-1)
    along, up = np.meshgrid(np.linspace(15, 19, 20), np.linspace(-1.4, -0.2, 10))
    side = np.stack([along, np.full_like(along, -0.9), up], axis=-1)
    points = np.concatenate([part.reshape(-1, 3) for part in (ground, back, side)])
    return SmallFrame((points + rng.normal(scale=0.01, size=points.shape)).astype(np.float32))


def kitti_bin(points_velo: NDArray[np.float32]) -> bytes:
    return np.pad(points_velo, ((0, 0), (0, 1))).astype("<f4").tobytes()


def calib_json(**changes: Any) -> bytes:
    return json.dumps({"P2": P2, "cam_T_velo": CAM_T_VELO, "image_size": [WIDTH, HEIGHT], **changes}).encode()


def calib_text(p2: str = "700 0 600 0 0 700 180 0 0 0 1 0") -> bytes:
    return f"P2: {p2}\nR0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0\n".encode()


def png(array: NDArray[Any]) -> bytes:
    """(H, W[, 3]) uint8 or (H, W) uint16 -> PNG."""
    stream = io.BytesIO()
    Image.fromarray(array).save(stream, "PNG")
    return stream.getvalue()


def mask_png(left: int, top: int, right: int, bottom: int, size: tuple[int, int] = (WIDTH, HEIGHT)) -> bytes:
    """A 16-bit mask image with prompt 0 in a rectangle."""
    ids = np.zeros(size[::-1], np.uint16)
    ids[top:bottom, left:right] = 1
    return png(ids)


def png_bomb(side: int) -> bytes:
    """A small PNG that says it has side x side pixels."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)
    pixels = zlib.compress(bytes(1_000_000))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")
