"""The form of POST /label: from a frame, or from files as they are.

From a frame every number is sent exactly (float32 points, calibration as JSON), so that a service gives
the very labels that a labeller here would give.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boxlift.errors import ImageError, InputError, MissingExtraError
from boxlift.formats import prompts as prompt_format
from boxlift.frame import Frame, Prompt
from boxlift.settings import LabellerSettings

# Field of the form -> (file name, content, media type).
Form = dict[str, tuple[str | None, bytes, str]]

_JSON = "application/json"
_BINARY = "application/octet-stream"
_TEXT = "text/plain; charset=utf-8"


def form_of_frame(frame: Frame, settings: LabellerSettings, *, detect: bool = False) -> Form:
    """The form that asks for `frame` to be labelled with `settings`.

    It holds the prompts and masks and no image; to `detect`, the image alone. Raises ImageError where
    there is none.
    """
    width, height = frame.image_size_px
    calibration = {
        "P2": frame.calibration.image_P_cam.tolist(),
        "cam_T_velo": frame.calibration.cam_SE3_velo.tolist(),
        "image_size": [int(width), int(height)],
    }
    form: Form = {
        "name": (None, frame.name.encode(), _TEXT),
        "points": ("points.npy", _npy(frame.points_velo[:, :3]), _BINARY),
        "calib": ("calib.json", json.dumps(calibration).encode(), _JSON),
        "options": (None, settings.model_dump_json().encode(), _JSON),
    }
    if detect:
        if frame.image is None:
            raise ImageError(
                "image", f"frame {frame.name!r} has no image to find objects in.", "Add it, or give prompts."
            )
        form["image"] = ("image.png", _png(frame.image), "image/png")
        return form
    form["prompts"] = (None, prompt_format.to_json(frame.prompts).encode(), _JSON)
    if frame.instance_ids is not None:
        form["masks"] = ("masks.png", _png(frame.instance_ids.astype(np.uint16)), "image/png")
    return form


def form_of_files(
    points: Path | str | bytes,
    calib: Path | str | bytes,
    prompts: Sequence[Prompt] | None,
    *,
    image: Path | str | bytes | None = None,
    masks: Path | str | bytes | None = None,
    name: str | None = None,
    options: Mapping[str, Any] | None = None,
) -> Form:
    """The form with files, or their bytes, as they are; decoding them is the service's. See Client."""
    form: Form = {
        "points": _file("points", points),
        "calib": _file("calib", calib),
    }
    if prompts is not None:
        form["prompts"] = (None, prompt_format.to_json(prompts).encode(), _JSON)
    if image is not None:
        form["image"] = _file("image", image)
    if masks is not None:
        form["masks"] = _file("masks", masks)
    if name is not None:
        form["name"] = (None, name.encode(), _TEXT)
    if options is not None:
        form["options"] = (None, json.dumps(dict(options)).encode(), _JSON)
    return form


def _file(field: str, source: Path | str | bytes) -> tuple[str, bytes, str]:
    if isinstance(source, bytes):
        return field, source, _BINARY
    try:
        return Path(source).name, Path(source).read_bytes(), _BINARY
    except OSError as error:
        raise InputError(field, f"{str(source)!r} cannot be read ({error.strerror}).", "Check it.") from None


def _npy(points: NDArray[np.floating]) -> bytes:
    stream = io.BytesIO()
    np.save(stream, np.ascontiguousarray(points, dtype=np.float32))
    return stream.getvalue()


def _png(pixels: NDArray[np.unsignedinteger]) -> bytes:
    try:
        from PIL import Image
    except ModuleNotFoundError:
        raise MissingExtraError("pillow", "client") from None
    stream = io.BytesIO()
    # The fastest compression: masks are few large areas, and images hardly get smaller.
    Image.fromarray(pixels).save(stream, "PNG", compress_level=1)
    return stream.getvalue()
