"""Images and masks: what is read, and that size is known before pixels are."""

from __future__ import annotations

import contextlib
import io
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from boxlift.errors import ImageError, PromptError
from boxlift.formats.image import decode_image, decode_instance_ids, image_size

PICTURE = np.random.default_rng(0).integers(0, 256, (30, 50, 3), dtype=np.uint8)


def encoded(image: Image.Image, kind: str = "PNG") -> bytes:
    stream = io.BytesIO()
    image.save(stream, kind, quality=95)
    return stream.getvalue()


PNG, JPEG = (encoded(Image.fromarray(PICTURE), kind) for kind in ("PNG", "JPEG"))


def bomb(width: int, height: int) -> bytes:
    """A PNG of a few bytes whose header promises many pixels."""

    def chunk(name: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(b""))
        + chunk(b"IEND", b"")
    )


def test_png_is_exact_and_jpeg_close() -> None:
    np.testing.assert_array_equal(decode_image(PNG), PICTURE)
    smooth = np.tile(np.arange(50, dtype=np.uint8)[:, None] * 4, (30, 1, 3))
    decoded = decode_image(encoded(Image.fromarray(smooth), "JPEG"))
    assert np.abs(decoded.astype(int) - smooth).max() < 8


@pytest.mark.parametrize("mode", ["L", "RGBA", "P", "1", "LA"])
def test_other_modes_become_rgb(mode: str) -> None:
    assert decode_image(encoded(Image.fromarray(PICTURE).convert(mode))).shape == (30, 50, 3)


@pytest.mark.parametrize("data", [PNG, JPEG])
def test_size_is_width_then_height(data: bytes, tmp_path: Path) -> None:
    assert image_size(data) == (50, 30)
    path = tmp_path / "image"
    path.write_bytes(data)
    assert image_size(path) == (50, 30)
    assert decode_image(path).shape == (30, 50, 3)


def test_size_needs_no_pixels() -> None:
    assert image_size(PNG[:60]) == (50, 30)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "no PNG or JPEG"),
        (b"just text", "b'just tex'"),
        (encoded(Image.fromarray(PICTURE), "BMP"), "no PNG or JPEG"),
        (PNG[:-40], "cannot be decoded"),
        (JPEG[: len(JPEG) // 2], "cannot be decoded"),
        (bomb(9000, 9000), "9000 x 9000"),
        (bomb(60_000, 60_000), "60000 x 60000"),
        (encoded(Image.fromarray(np.zeros((5, 5), np.uint16))), "mode"),
    ],
    ids=["empty", "text", "bmp", "cut png", "cut jpeg", "large", "bomb", "16 bit"],
)
def test_images_that_are_refused(data: bytes, says: str) -> None:
    with pytest.raises(ImageError) as caught:
        decode_image(data)
    assert caught.value.field == "image"
    assert says in caught.value.problem
    assert caught.value.remedy


def test_limit_of_pixels() -> None:
    assert image_size(PNG, max_pixels=1500) == (50, 30)
    with pytest.raises(ImageError, match="more than 1499"):
        image_size(PNG, max_pixels=1499)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_masks_round_trip(dtype: type[np.unsignedinteger]) -> None:
    largest = np.iinfo(dtype).max
    ids = np.random.default_rng(1).integers(0, largest, (7, 9), dtype=dtype, endpoint=True)
    ids[0, 0] = largest
    decoded = decode_instance_ids(encoded(Image.fromarray(ids)))
    assert decoded.dtype == np.uint16
    np.testing.assert_array_equal(decoded, ids)


def test_palette_masks_are_their_indices() -> None:
    ids = np.array([[0, 1], [2, 3]], np.uint8)
    picture = Image.new("P", (2, 2))
    picture.putdata(ids.ravel().tolist())
    picture.putpalette([255, 0, 0, 0, 255, 0, 0, 0, 255, 9, 9, 9])
    np.testing.assert_array_equal(decode_instance_ids(encoded(picture)), ids)


@pytest.mark.parametrize(
    "data", [PNG, JPEG, b"text", encoded(Image.fromarray(PICTURE[..., 0]), "JPEG"), PNG[:-40]]
)
def test_masks_that_are_refused(data: bytes) -> None:
    with pytest.raises(PromptError) as caught:
        decode_instance_ids(data)
    assert caught.value.field == "masks"
    assert caught.value.remedy


@given(st.sampled_from([PNG, JPEG]), st.data())
@settings(max_examples=150, deadline=None)
def test_damaged_images(original: bytes, draw: st.DataObject) -> None:
    data = bytearray(original)
    for _ in range(draw.draw(st.integers(1, 3))):
        at = draw.draw(st.integers(0, min(len(data) - 1, 400)))
        data[at : at + draw.draw(st.integers(0, 3))] = draw.draw(st.binary(max_size=4))
    with contextlib.suppress(ImageError):
        assert decode_image(bytes(data)).ndim == 3
