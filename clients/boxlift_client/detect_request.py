"""The form of POST /detect: from an array, or from files as they are."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Calibration
from boxlift.errors import ImageError
from boxlift.formats import prompts as prompt_format
from boxlift.formats.image import encoded_png
from boxlift.frame import Prompt
from boxlift_client.request_parts import BINARY, JSON, PNG, File, Parts, content


def parts_of_image(
    image: NDArray[np.uint8],
    calibration: Calibration,
    prompts: Sequence[Prompt] | None,
    min_score: float | None,
    name: str,
) -> Parts:
    """The form for one (H, W, 3) uint8 RGB image; every number and pixel is sent exactly."""
    camera = {"P2": calibration.image_P_cam.tolist()}
    parts: Parts = [
        ("image", (f"{name}.png", _png(image), PNG)),
        ("calib", (None, json.dumps(camera).encode(), JSON)),
    ]
    return parts + _texts(None if prompts is None else prompt_format.to_json(prompts), min_score)


def parts_of_files(
    images: Sequence[File],
    calibs: Sequence[File],
    prompts: Sequence[Sequence[Prompt]] | None,
    min_score: float | None,
    names: Sequence[str] | None,
) -> Parts:
    """The form with files, or their bytes, as they are. Raises InputError where one cannot be read."""
    parts: Parts = []
    for index, image in enumerate(images):
        filename = None if isinstance(image, bytes) else Path(image).name
        if names is not None:
            filename = f"{names[index]}.image"
        parts.append(("image", (filename or f"frame-{index}", content("image", image), BINARY)))
    parts.extend(("calib", ("calib", content("calib", calib), BINARY)) for calib in calibs)
    return parts + _texts(None if prompts is None else prompt_format.lists_to_json(prompts), min_score)


def _texts(prompts_json: str | None, min_score: float | None) -> Parts:
    parts: Parts = []
    if prompts_json is not None:
        parts.append(("prompts", (None, prompts_json.encode(), JSON)))
    if min_score is not None:
        parts.append(("min_score", (None, repr(float(min_score)).encode(), "text/plain")))
    return parts


def _png(image: NDArray[np.uint8]) -> bytes:
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or image.size == 0:
        raise ImageError("image", f"the array is {image.dtype} {image.shape}.", "Give uint8 (H, W, 3), RGB.")
    return encoded_png(image)
