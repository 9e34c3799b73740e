"""What the service answers when all is well."""

from __future__ import annotations

from collections.abc import Iterable

from pydantic import BaseModel, ConfigDict, Field

import boxlift
from boxlift.formats.details import ObjectDetails, WarningDetails, details_of
from boxlift.frame import FrameLabels
from boxlift.settings import LabellerSettings

API_VERSION = "1"


class _Answer(BaseModel):
    model_config = ConfigDict(frozen=True)


class LabelAnswer(_Answer):
    """The labels of one frame, and with what they were made."""

    frame: str = Field(description="Name of the frame; it seeds every random choice.")
    objects: tuple[ObjectDetails, ...] = Field(description="One entry per prompt, in their order.")
    warnings: tuple[WarningDetails, ...] = Field(
        description="Doubts about the calibration; labels of a frame that has any may be worthless."
    )
    dropped_points: int = Field(description="Points that were left out: not finite, or beyond 100 km.")
    preset: str = Field(description="Preset that the settings started from.")
    settings_fingerprint: str = Field(description="Changes when any setting of the labeller does.")
    model_digest: str | None = Field(
        description="SHA-256 of the file of the detector that found the prompts; null: they were given."
    )
    api_version: str = Field(description="Version of this HTTP interface.")
    boxlift_version: str = Field(description="Version of the package.")


class UsedModel(_Answer):
    """A model that an answer was made with."""

    name: str = Field(description="Name of its file, without suffix.")
    digest: str = Field(description="SHA-256 of its file.")


class ImageAnswer(_Answer):
    """What was found in one image."""

    frame: str = Field(description="File name of the image without its suffix; 'frame' where it had none.")
    image_size: tuple[int, int] = Field(description="Width and height, pixels.")
    objects: tuple[ObjectDetails, ...] = Field(
        description="With prompts one entry each, in their order; without, what was found. `score` is the "
        "confidence in the 3D box, `prompt_score` that in the 2D box, `depth_spread` the relative standard "
        "deviation of the depth."
    )
    warnings: tuple[WarningDetails, ...] = Field(
        description="Doubts about the camera; boxes of an image that has any may be worthless."
    )


class DetectAnswer(_Answer):
    """The objects of one or several images, and with what they were found."""

    images: tuple[ImageAnswer, ...] = Field(description="One entry per image, in their order.")
    model: UsedModel = Field(description="The monocular model.")
    detector: UsedModel | None = Field(
        description="The 2D detector that was set for this service and found the objects; null: prompts were "
        "given, or the monocular model found them itself."
    )
    api_version: str = Field(description="Version of this HTTP interface.")
    boxlift_version: str = Field(description="Version of the package.")


class LabellerModel(_Answer):
    """A labeller that POST /label can use: a preset with its settings."""

    preset: str
    fingerprint: str = Field(description="The settings_fingerprint of answers without other options.")
    settings: LabellerSettings


class OnnxModelAnswer(UsedModel):
    """A model of this service."""

    classes: tuple[str, ...] = Field(description="What it knows.")
    metadata: dict[str, str] = Field(description="What its file says of itself: training data, licence, ...")


class ModelsAnswer(_Answer):
    """What this service can label and detect with."""

    boxlift_version: str = Field(description="Version of the package.")
    labellers: tuple[LabellerModel, ...]
    default_preset: str
    detector: OnnxModelAnswer | None = Field(description="The 2D detector of POST /label; null: see missing.")
    monocular: OnnxModelAnswer | None = Field(description="The model of POST /detect; null: see missing.")
    missing: dict[str, str] = Field(description="Why a model is not there, by its name above.")


class StatusAnswer(_Answer):
    """A probe's answer."""

    status: str


def label_answer_of(
    labels: FrameLabels, settings: LabellerSettings, dropped_points: int, model_digest: str | None
) -> LabelAnswer:
    """The JSON answer to POST /label."""
    details = details_of(labels)
    return LabelAnswer(
        frame=details.frame,
        objects=details.objects,
        warnings=details.warnings,
        dropped_points=dropped_points,
        preset=settings.preset,
        settings_fingerprint=settings.fingerprint(),
        model_digest=model_digest,
        api_version=API_VERSION,
        boxlift_version=boxlift.__version__,
    )


def detect_answer_of(
    images: Iterable[tuple[FrameLabels, tuple[int, int]]], model: UsedModel, detector: UsedModel | None
) -> DetectAnswer:
    """The JSON answer to POST /detect: labels and (width, height) of each image."""

    def answer(labels: FrameLabels, size_px: tuple[int, int]) -> ImageAnswer:
        details = details_of(labels)
        return ImageAnswer(
            frame=details.frame, image_size=size_px, objects=details.objects, warnings=details.warnings
        )

    return DetectAnswer(
        images=tuple(answer(labels, size_px) for labels, size_px in images),
        model=model,
        detector=detector,
        api_version=API_VERSION,
        boxlift_version=boxlift.__version__,
    )
