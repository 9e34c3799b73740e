"""From the parts of a form to what POST /detect asks for. Runs in the process that finds objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePath

import numpy as np
from numpy.typing import NDArray

from boxlift.errors import CalibrationError, OptionsError, PromptError
from boxlift.formats.calibration import ParsedCalibration, parse_calibration
from boxlift.formats.image import decode_image
from boxlift.formats.prompts import parse_prompt_lists
from boxlift.frame import Prompt
from boxlift_service.bodies.form import Field
from boxlift_service.bodies.shared_parts import Part
from boxlift_service.settings import ServiceSettings

DEFAULT_NAME = "frame"


@dataclass(frozen=True)
class ImageRequest:
    """One image of a request, still encoded; `field` and `calib_field` are what errors call its parts."""

    name: str
    data: bytes
    field: str
    parsed: ParsedCalibration
    calib_field: str
    prompts: tuple[Prompt, ...] | None

    def decode(self, max_pixels: int) -> NDArray[np.uint8]:
        """(H, W, 3) uint8 RGB. Raises ImageError; CalibrationError where it says another size."""
        image = decode_image(self.data, self.field, max_pixels)
        size_px = image.shape[1], image.shape[0]
        if self.parsed.image_size_px not in (None, size_px):
            raise CalibrationError(
                f"{self.calib_field}.image_size",
                f"it is {self.parsed.image_size_px}, the image has {size_px}.",
                "Leave it out, or give the calibration of this image.",
            )
        return image


@dataclass(frozen=True)
class DetectRequest:
    """What POST /detect asks for."""

    images: tuple[ImageRequest, ...]
    min_score: float


def detect_fields(limits: ServiceSettings) -> dict[str, Field]:
    """The fields of POST /detect."""
    return {
        "image": Field(limits.max_body_bytes, required=True, max_parts=limits.max_images),
        "calib": Field(2**20, required=True, max_parts=limits.max_images),
        "prompts": Field(2**22),
        "min_score": Field(64),
    }


def decode_detect_request(parts: Mapping[str, tuple[Part, ...]], limits: ServiceSettings) -> DetectRequest:
    """Parts with images and calibrations among them -> what is asked for. Raises InputError.

    Images are left encoded, so that one at a time is held as pixels.
    """
    images = parts["image"]
    calibrations = _calibrations(parts["calib"], len(images))
    prompts = _prompts(parts["prompts"][0], len(images), limits) if "prompts" in parts else None
    return DetectRequest(
        tuple(
            ImageRequest(
                _name(part, index, len(images)),
                part.data,
                _numbered("image", index, len(images)),
                *calibrations[index],
                None if prompts is None else prompts[index],
            )
            for index, part in enumerate(images)
        ),
        _min_score(parts["min_score"][0]) if "min_score" in parts else limits.min_score,
    )


def _calibrations(parts: tuple[Part, ...], image_count: int) -> list[tuple[ParsedCalibration, str]]:
    """One per image, and what errors call it; a single one is that of all images."""
    if len(parts) not in (1, image_count):
        raise CalibrationError(
            "calib",
            f"there are {len(parts)} calibrations for {image_count} images.",
            "Send one for all images, or one for each, in the same order.",
        )
    fields = [_numbered("calib", index, len(parts)) for index in range(len(parts))]
    parsed = [
        (parse_calibration(part.data, field, camera_only=True), field)
        for part, field in zip(parts, fields, strict=True)
    ]
    return parsed if len(parsed) == image_count else parsed * image_count


def _prompts(part: Part, image_count: int, limits: ServiceSettings) -> tuple[tuple[Prompt, ...], ...]:
    """One tuple per image."""
    lists = parse_prompt_lists(part.data, image_count)
    for index, prompts in enumerate(lists):
        if len(prompts) > limits.max_prompts:
            raise PromptError(
                _numbered("prompts", index, image_count),
                f"there are {len(prompts)} prompts.",
                f"Give at most {limits.max_prompts} an image.",
            )
    return lists


def _min_score(part: Part) -> float:
    text = part.data.decode("ascii", "replace")
    try:
        min_score = float(text)
    except ValueError:
        min_score = -1.0
    if not 0 <= min_score <= 1:
        raise OptionsError("min_score", f"{text!r:.60} is no score.", "Give a number from 0 to 1.")
    return min_score


def _name(part: Part, index: int, image_count: int) -> str:
    """The stem of the image's file name, else a fixed name."""
    stem = PurePath(part.filename or "").stem
    if stem and stem.isprintable():
        return stem
    return DEFAULT_NAME if image_count == 1 else f"{DEFAULT_NAME}-{index}"


def _numbered(field: str, index: int, count: int) -> str:
    """What errors call one part of several of the same name."""
    return field if count == 1 else f"{field}[{index}]"
