"""The models that find objects, as the worker process holds them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np

from boxlift.camera import Calibration
from boxlift.detector import Detector
from boxlift.errors import BoxliftError, InputError, MissingExtraError, ModelFileError
from boxlift.formats.image import decode_image
from boxlift.frame import Prompt
from boxlift.monocular import Monocular
from boxlift.settings import LabellerSettings
from boxlift_service.settings import ENVIRONMENT_PREFIX, ServiceSettings
from boxlift_service.telemetry.logs import configure_logging

T = TypeVar("T")


class NoModelError(BoxliftError):
    """A request needs a model that is not there; says why."""


@dataclass(frozen=True)
class ModelInfo:
    """What is told of a model; or, in `missing`, why there is none."""

    name: str = ""
    digest: str = ""
    classes: tuple[str, ...] = ()
    metadata: dict[str, str] = field(default_factory=dict)
    missing: str | None = None


@dataclass(frozen=True)
class Models:
    """The 2D detector and the monocular model, or why they are not there.

    A detector that was set, `settings.detector`, also looks for the monocular model.
    """

    detector: Detector | BoxliftError
    monocular: Monocular | BoxliftError
    settings: ServiceSettings
    presets: Mapping[str, LabellerSettings]

    def require_detector(self) -> Detector:
        """The 2D detector. Raises NoModelError."""
        if isinstance(self.detector, BoxliftError):
            raise NoModelError(f"There is no detector ({self.detector}).")
        return self.detector

    def detector_of_images(self) -> Detector | None:
        """Who finds the objects of POST /detect: a detector of the user's own; None: the monocular model."""
        return None if self.settings.detector is None else self.require_detector()

    def require_monocular(self) -> Monocular:
        """The monocular model. Raises NoModelError."""
        if isinstance(self.monocular, BoxliftError):
            raise NoModelError(f"There is no monocular model ({self.monocular}).")
        return self.monocular


def open_models(settings: ServiceSettings, presets: Mapping[str, LabellerSettings]) -> Models:
    """Load what the settings name, or what ships, and run each once; one that fails is its error."""
    configure_logging(settings.log_format, settings.log_level)
    threads = settings.detect_threads
    return Models(
        _opened("detector", settings.detector, lambda: _ready_detector(settings.detector, threads)),
        _opened("model", settings.model, lambda: _ready_monocular(settings.model, threads)),
        settings,
        presets,
    )


def infos_of(models: Models) -> tuple[ModelInfo, ModelInfo]:
    """What is told of the detector and of the monocular model; work for the worker process."""
    return _info(models.detector), _info(models.monocular)


def require_given(models: Models) -> None:
    """Raises the error of any of the models that cannot be used; work for the worker process."""
    for model in (models.detector, models.monocular):
        if isinstance(model, InputError) and model.field.startswith(ENVIRONMENT_PREFIX):
            raise model
        if isinstance(model, MissingExtraError):
            raise model


def _opened(setting: str, path: Path | None, open_: Callable[[], T]) -> T | BoxliftError:
    """What `open_` returns or raises; the error of a file that was set names the variable."""
    try:
        return open_()
    except ModelFileError as error:
        if path is None:
            return error
        variable = f"{ENVIRONMENT_PREFIX}{setting.upper()}"
        return ModelFileError(variable, f"{error.field}: {error.problem}", error.remedy)
    except BoxliftError as error:
        return error


def _ready_detector(path: Path | None, threads: int) -> Detector:
    detector = Detector.open(path, threads)
    detector.detect(_GREY)
    return detector


def _ready_monocular(path: Path | None, threads: int) -> Monocular:
    decode_image(_ONE_PIXEL_PNG)  # Pillow and its codecs load with the first image
    monocular = Monocular.open(path, threads)
    monocular.detect("warm-up", _GREY, _CAMERA)
    monocular.detect("warm-up", _GREY, _CAMERA, [Prompt(monocular.classes[0], (560.0, 150.0, 660.0, 220.0))])
    return monocular


_ONE_PIXEL_PNG = bytes.fromhex(
    "89504e470d0a1a0a0000000d49484452000000010000000108000000003a7e9b55"
    "0000000a49444154789c63a8070000810080d394534a0000000049454e44ae426082"
)
# As large as most images that come; the first run allocates for that.
_GREY = np.full((375, 1242, 3), 127, np.uint8)
_CAMERA = Calibration(
    np.array([[720.0, 0, 610, 0], [0, 720, 173, 0], [0, 0, 1, 0]]),
    np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]),
)


def _info(model: Detector | Monocular | BoxliftError) -> ModelInfo:
    if isinstance(model, BoxliftError):
        return ModelInfo(missing=str(model))
    if isinstance(model, Detector):
        return ModelInfo(model.name, model.digest, model.class_names)
    return ModelInfo(model.name, model.digest, model.classes, dict(model.metadata))
