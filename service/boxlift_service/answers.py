"""What the service answers when all is well."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

import boxlift
from boxlift.formats.details import ObjectDetails, WarningDetails, details_of
from boxlift.frame import FrameLabels
from boxlift.settings import LabellerSettings
from boxlift_service.decoding import LabelRequest

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
    model_digest: str | None = Field(description="Digest of the detector's weights; null without a detector.")
    api_version: str = Field(description="Version of this HTTP interface.")
    boxlift_version: str = Field(description="Version of the package.")


class LabellerModel(_Answer):
    """A labeller that POST /label can use: a preset with its settings."""

    preset: str
    fingerprint: str = Field(description="The settings_fingerprint of answers without other options.")
    settings: LabellerSettings


class ModelsAnswer(_Answer):
    """What this service can label and detect with."""

    labellers: tuple[LabellerModel, ...]
    default_preset: str
    detector: str | None = Field(description="Name of the detector; null: none is installed.")


class StatusAnswer(_Answer):
    """A probe's answer."""

    status: str


def label_answer_of(request: LabelRequest, labels: FrameLabels) -> LabelAnswer:
    """The JSON answer to POST /label."""
    details = details_of(labels)
    return LabelAnswer(
        frame=details.frame,
        objects=details.objects,
        warnings=details.warnings,
        dropped_points=request.dropped_points,
        preset=request.settings.preset,
        settings_fingerprint=request.settings.fingerprint(),
        model_digest=None,
        api_version=API_VERSION,
        boxlift_version=boxlift.__version__,
    )
