"""Camera images and instance masks: PNG and JPEG by Pillow, which gets no more of them than pixels need.

An orientation that a JPEG carries (EXIF) is not applied: calibrations speak of the stored pixels.
"""

from __future__ import annotations

import importlib
import io
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from boxlift.errors import ImageError, InputError, MissingExtraError, PromptError
from boxlift.formats.archives import archive_kind
from boxlift.formats.image_parts import ImageParts, image_parts
from boxlift.storage import read_whole

if TYPE_CHECKING:
    from PIL import Image as PillowImage

    from boxlift.storage import AnyPath

SUFFIXES = (".png", ".jpg", ".jpeg")

# 64 megapixels: any camera that drives; 192 MB decoded.
MAX_PIXELS = 64_000_000
# Beyond it a row alone, or the list of rows, would take more memory than the pixels.
_LARGEST_SIDE_PX = 65_535
_REMEDY = "Give a PNG or JPEG image."


def read_image(path: AnyPath) -> bytes:
    """The bytes of an image file. Raises ImageError where it cannot be read."""
    try:
        return read_whole(path)
    except OSError as error:
        problem = f"the image cannot be read ({error.strerror or error})."
        raise ImageError(str(path), problem, "Check the path.") from None


def image_size(
    source: bytes | AnyPath, field: str = "image", max_pixels: int = MAX_PIXELS
) -> tuple[int, int]:
    """(width, height) in pixels from the header of an encoded image or image file; no pixel is decoded.

    Raises ImageError where it is no PNG or JPEG, or has more than `max_pixels`.
    """
    return _parts(source, field, max_pixels, ImageError).size_px


def decode_image(
    source: bytes | AnyPath, field: str = "image", max_pixels: int = MAX_PIXELS
) -> NDArray[np.uint8]:
    """An encoded image or image file -> (H, W, 3) uint8 RGB; alpha is dropped.

    Raises ImageError where it is no PNG or JPEG of 8 bits a channel, truncated or too large.
    """
    with _open(source, field, max_pixels, ImageError) as image:
        if image.mode in ("I", "F") or image.mode.startswith("I;"):
            raise ImageError(field, f"the image has mode {image.mode!r}.", "Give 8 bits a channel.")
        _load(image, field, ImageError)
        return np.array(image if image.mode == "RGB" else image.convert("RGB"))


def encoded_png(pixels: NDArray[np.unsignedinteger]) -> bytes:
    """(H, W) masks or (H, W, 3) RGB -> a PNG file's bytes. Raises MissingExtraError without Pillow."""
    buffer = io.BytesIO()
    # The fastest compression: masks are few large areas, and images hardly get smaller.
    _pillow().fromarray(pixels).save(buffer, "PNG", compress_level=1)
    return buffer.getvalue()


def encoded_jpeg(pixels: NDArray[np.uint8], quality: int = 90) -> bytes:
    """(H, W, 3) RGB -> a JPEG file's bytes. Raises MissingExtraError without Pillow."""
    buffer = io.BytesIO()
    _pillow().fromarray(pixels).save(buffer, "JPEG", quality=quality)
    return buffer.getvalue()


def resized(image: NDArray[np.uint8], size_px: tuple[int, int]) -> NDArray[np.uint8]:
    """(H, W, 3) RGB -> the same image with (width, height) pixels, each averaged over what it covers.

    Raises MissingExtraError without Pillow.
    """
    pillow = _pillow()
    # The gap lets Pillow begin with whole blocks of pixels.
    small = pillow.fromarray(image).resize(size_px, pillow.Resampling.BILINEAR, reducing_gap=3.0)
    return np.asarray(small, dtype=np.uint8)


def decode_instance_ids(
    source: bytes | AnyPath, field: str = "masks", max_pixels: int = MAX_PIXELS
) -> NDArray[np.uint16]:
    """A PNG with one channel of 16 or 8 bits (or a palette) -> (H, W) uint16: prompt index + 1, 0 is none.

    Raises PromptError where it is something else.
    """
    with _open(source, field, max_pixels, PromptError) as image:
        if image.format != "PNG" or not (image.mode in ("L", "P", "1", "I") or image.mode.startswith("I;16")):
            raise PromptError(
                field,
                f"the masks are {image.format} of mode {image.mode!r}.",
                "Give a 16-bit PNG with one channel: prompt index + 1, 0 for no object.",
            )
        _load(image, field, PromptError)
        return np.array(image).astype(np.uint16)


def _parts(source: bytes | AnyPath, field: str, max_pixels: int, error_type: type[InputError]) -> ImageParts:
    """Reads and judges all but the pixels."""
    try:
        data = source if isinstance(source, bytes) else read_whole(source)
        parts = image_parts(data)
    except OSError as error:
        raise error_type(field, f"the image cannot be read ({error.strerror}).", "Check the path.") from None
    except ValueError as error:
        raise error_type(field, f"the image cannot be opened ({error}).", _REMEDY) from None
    if parts is None:
        what = archive_kind(data) or f"data that begins with {data[:8]!r}"
        raise error_type(field, f"it is {what}, no PNG or JPEG.", _REMEDY)
    width, height = parts.size_px
    if not (0 < width <= _LARGEST_SIDE_PX and 0 < height <= _LARGEST_SIDE_PX):
        raise error_type(
            field,
            f"the image has {width} x {height} pixels.",
            f"Give an image of 1 to {_LARGEST_SIDE_PX} pixels on a side.",
        )
    if width * height > max_pixels:
        raise error_type(
            field,
            f"the image has {width} x {height} pixels, more than {max_pixels}.",
            "Give a smaller image (and scale its calibration alike).",
        )
    return parts


def _open(
    source: bytes | AnyPath, field: str, max_pixels: int, error_type: type[InputError]
) -> PillowImage.Image:
    parts = _parts(source, field, max_pixels, error_type)
    pillow = _pillow()
    try:
        image: PillowImage.Image = pillow.open(io.BytesIO(parts.data), formats=("PNG", "JPEG"))
    # Pillow's readers raise a dozen types for damaged headers (and for bombs beyond 179 megapixels).
    except Exception as error:
        raise error_type(field, f"the image cannot be opened ({error!s:.120}).", _REMEDY) from None
    return image


def _pillow() -> Any:
    try:
        return importlib.import_module("PIL.Image")
    except ModuleNotFoundError:
        raise MissingExtraError("pillow", "label") from None


def _load(image: PillowImage.Image, field: str, error_type: type[InputError]) -> None:
    try:
        image.load()
    # As above: truncated and damaged data surface as OSError, SyntaxError, ValueError, zlib.error, ...
    except Exception as error:
        raise error_type(
            field, f"the image cannot be decoded ({error!s:.120}).", "The file is truncated or damaged."
        ) from None
