"""From the parts of a form to what the labeller takes. Runs in a worker, never in the event loop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePath

import numpy as np
from numpy.typing import NDArray

from boxlift.errors import (
    CalibrationError,
    ImageError,
    InputError,
    PromptError,
)
from boxlift.formats.calibration import parse_calibration
from boxlift.formats.image import decode_instance_ids, image_size
from boxlift.formats.point_cloud import decode_points
from boxlift.formats.prompts import parse_prompts
from boxlift.frame import Frame, Prompt
from boxlift.settings import LabellerSettings
from boxlift_service.bodies.form import Field
from boxlift_service.bodies.shared_parts import Part
from boxlift_service.options import labeller_settings
from boxlift_service.settings import ServiceSettings

DEFAULT_NAME = "frame"
_LONGEST_NAME = 200


@dataclass(frozen=True)
class LabelRequest:
    """What POST /label asks for; in a request without prompts they are yet to be found in its image."""

    frame: Frame
    settings: LabellerSettings
    dropped_points: int


def label_fields(limits: ServiceSettings) -> dict[str, Field]:
    """The fields of POST /label."""
    return {
        "points": Field(limits.max_body_bytes, required=True),
        "calib": Field(2**20, required=True),
        "image": Field(limits.max_body_bytes),
        "prompts": Field(2**22),
        "masks": Field(limits.max_body_bytes),
        "options": Field(2**16),
        "name": Field(4 * _LONGEST_NAME),
    }


def decode_label_request(
    parts: Mapping[str, Part],
    limits: ServiceSettings,
    presets: Mapping[str, LabellerSettings],
) -> LabelRequest:
    """Parts with points, calib, and prompts or an image among them -> frame and settings.

    Raises InputError.
    """
    settings = labeller_settings(parts.get("options"), presets)
    prompts = _prompts(parts, limits)
    parsed = parse_calibration(parts["calib"].data)
    size_px = _image_size(parts, parsed.image_size_px, limits)
    decoded = decode_points(parts["points"].data, parts["points"].filename, max_points=limits.max_points)
    frame = Frame(
        name=_frame_name(parts),
        points_velo=decoded.points,
        calibration=parsed.calibration,
        image_size_px=size_px,
        prompts=prompts,
        instance_ids=_instance_ids(parts.get("masks"), limits),
    )
    return LabelRequest(frame, settings, decoded.dropped)


def _prompts(parts: Mapping[str, Part], limits: ServiceSettings) -> tuple[Prompt, ...]:
    """The prompts of the form; none yet where they are to be found in the image."""
    if "prompts" in parts:
        prompts = parse_prompts(parts["prompts"].data)
        if len(prompts) <= limits.max_prompts:
            return prompts
        raise PromptError(
            "prompts", f"there are {len(prompts)} prompts.", f"Give at most {limits.max_prompts} a frame."
        )
    if "masks" in parts:
        raise PromptError("masks", "masks number prompts, and there are none.", "Send the field prompts.")
    if "image" not in parts:
        raise ImageError(
            "image",
            "without prompts, objects are found in the image, and there is none.",
            "Send the field image, or prompts.",
        )
    return ()


def _image_size(
    parts: Mapping[str, Part], calibrated_px: tuple[int, int] | None, limits: ServiceSettings
) -> tuple[int, int]:
    """Width and height as image, calibration or masks say, in this order."""
    if "image" in parts:
        size_px = image_size(parts["image"].data, max_pixels=limits.max_image_pixels)
        if calibrated_px not in (None, size_px):
            raise CalibrationError(
                "calib.image_size", f"it is {calibrated_px}, the image has {size_px}.", "Leave one out."
            )
        return size_px
    if calibrated_px is not None:
        return calibrated_px
    if "masks" in parts:
        return image_size(parts["masks"].data, "masks", limits.max_image_pixels)
    raise CalibrationError(
        "calib.image_size",
        "nothing says how large the image is.",
        "Give image_size in a JSON calibration, or send the image.",
    )


def _instance_ids(part: Part | None, limits: ServiceSettings) -> NDArray[np.uint16] | None:
    return decode_instance_ids(part.data, max_pixels=limits.max_image_pixels) if part else None


def _frame_name(parts: Mapping[str, Part]) -> str:
    """The field name, else the stem of the points' file name, else a fixed name: it seeds the labels."""
    if "name" not in parts:
        stem = PurePath(parts["points"].filename or "").stem
        return stem if stem and stem.isprintable() else DEFAULT_NAME
    data = parts["name"].data
    name = data.decode("utf-8", "backslashreplace")
    if not 0 < len(name) <= _LONGEST_NAME or not name.isprintable() or name.encode() != data:
        raise InputError(
            "name", f"{name!r:.60} is no name.", f"Give 1 to {_LONGEST_NAME} printable characters."
        )
    return name
