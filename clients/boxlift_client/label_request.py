"""The form of POST /label: from a frame, or from files as they are.

From a frame every number is sent exactly (float32 points, calibration as JSON), so that a service gives
the very labels that a labeller here would give.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boxlift.errors import ImageError
from boxlift.formats import prompts as prompt_format
from boxlift.formats.image import encoded_png
from boxlift.frame import Frame, Prompt
from boxlift.settings import LabellerSettings
from boxlift_client.request_parts import BINARY, JSON, PNG, TEXT, File, Form, Part, content


@dataclass(frozen=True)
class FrameFiles:
    """A frame as files, or their bytes, in any format that the service reads.

    points: .bin, .npy, .npz, .pcd or .ply. calib: KITTI text or JSON. prompts: without them the service
    finds the objects in the image. image: PNG or JPEG, needed for that and where `calib` does not say
    image_size. masks: 16-bit PNG, prompt index + 1. name: of the frame, which seeds random choices; the
    stem of a points file where None. options: a preset and what to change of it, e.g.
    {"preset": "release", "fit": {"method": "adam"}}.
    """

    points: File
    calib: File
    prompts: Sequence[Prompt] | None = None
    image: File | None = None
    masks: File | None = None
    name: str | None = None
    options: Mapping[str, Any] | None = None


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
        "name": (None, frame.name.encode(), TEXT),
        "points": ("points.npy", _npy(frame.points_velo[:, :3]), BINARY),
        "calib": ("calib.json", json.dumps(calibration).encode(), JSON),
        "options": (None, settings.model_dump_json().encode(), JSON),
    }
    if detect:
        if frame.image is None:
            raise ImageError(
                "image", f"frame {frame.name!r} has no image to find objects in.", "Add it, or give prompts."
            )
        form["image"] = ("image.png", encoded_png(frame.image), PNG)
        return form
    form["prompts"] = (None, prompt_format.to_json(frame.prompts).encode(), JSON)
    if frame.instance_ids is not None:
        form["masks"] = ("masks.png", encoded_png(frame.instance_ids.astype(np.uint16)), PNG)
    return form


def form_of_files(files: FrameFiles) -> Form:
    """The form with files as they are; decoding them is the service's. Raises InputError."""
    form: Form = {}
    if files.name is not None:
        form["name"] = (None, files.name.encode(), TEXT)
    form["points"] = _file("points", files.points)
    form["calib"] = _file("calib", files.calib)
    if files.prompts is not None:
        form["prompts"] = (None, prompt_format.to_json(files.prompts).encode(), JSON)
    if files.image is not None:
        form["image"] = _file("image", files.image)
    if files.masks is not None:
        form["masks"] = _file("masks", files.masks)
    if files.options is not None:
        form["options"] = (None, json.dumps(dict(files.options)).encode(), JSON)
    return form


def _file(field: str, source: File) -> Part:
    return field if isinstance(source, bytes) else Path(source).name, content(field, source), BINARY


def _npy(points: NDArray[np.floating]) -> bytes:
    stream = io.BytesIO()
    np.save(stream, np.ascontiguousarray(points, dtype=np.float32))
    return stream.getvalue()
