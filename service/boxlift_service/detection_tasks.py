"""What the process with the models is asked to do: plain data on its way there, work once it is there."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxlift.detector import Detector
from boxlift.errors import CalibrationError
from boxlift.formats.details import details_of, kitti_text
from boxlift.formats.image import decode_image
from boxlift.frame import FrameLabels, Prompt
from boxlift.monocular import Monocular
from boxlift.stage_times import StageTimes
from boxlift_service.answers import UsedModel, detect_answer_of
from boxlift_service.detect_decoding import ImageRequest, decode_detect_request
from boxlift_service.detection_models import Models
from boxlift_service.form import Part
from boxlift_service.settings import ServiceSettings


@dataclass(frozen=True)
class FoundPrompts:
    """What a detector found: prompts, (H, W) prompt index + 1 where it has masks, and its digest."""

    prompts: tuple[Prompt, ...]
    instance_ids: NDArray[np.uint16] | None
    model_digest: str


@dataclass(frozen=True)
class FindPromptsTask:
    """POST /label without prompts: an encoded image, and the least score of what is to be found in it."""

    image: bytes
    min_score: float

    def __call__(self, models: Models) -> FoundPrompts:
        """Raises ImageError, NoModelError, ModelFileError."""
        detector, limits = models.require_detector(), models.settings
        image = decode_image(self.image, max_pixels=limits.max_image_pixels)
        found = detector.detect(image, self.min_score)
        # The best come first.
        return FoundPrompts(found.prompts[: limits.max_prompts], found.instance_ids, detector.digest)


@dataclass(frozen=True)
class DetectedImages:
    """The body of an answer, and the seconds per stage that it took, summed over the images."""

    content: bytes
    seconds: dict[str, float]


@dataclass(frozen=True)
class DetectTask:
    """POST /detect: the parts of the form, as they came."""

    parts: dict[str, tuple[Part, ...]]
    as_text: bool

    def __call__(self, models: Models) -> DetectedImages:
        """Raises InputError that names the field at fault, NoModelError, ModelFileError."""
        monocular = models.require_monocular()
        request = decode_detect_request(self.parts, models.settings)
        detector = models.detector_of_images() if "prompts" not in self.parts else None
        seconds: Counter[str] = Counter()
        found = []
        for image in request.images:
            times = StageTimes()
            found.append(_detect(image, request.min_score, monocular, detector, models.settings, times))
            seconds.update(times.seconds)
        times = StageTimes()
        with times.stage("encode"):
            if self.as_text:
                content = "".join(kitti_text(details_of(labels)) for labels, _ in found)
            else:
                used = None if detector is None else UsedModel(name=detector.name, digest=detector.digest)
                model = UsedModel(name=monocular.name, digest=monocular.digest)
                content = detect_answer_of(found, model, used).model_dump_json(by_alias=True)
        return DetectedImages(content.encode(), {**seconds, **times.seconds})


def _detect(
    asked: ImageRequest,
    min_score: float,
    monocular: Monocular,
    detector: Detector | None,
    limits: ServiceSettings,
    times: StageTimes,
) -> tuple[FrameLabels, tuple[int, int]]:
    """The labels of one image, and its (width, height)."""
    with times.stage("decode"):
        image = asked.decode(limits.max_image_pixels)
    prompts = asked.prompts
    if detector is not None:
        with times.stage("detect"):
            prompts = detector.detect(image).prompts[: limits.max_prompts]
    try:
        labels = monocular.detect(
            asked.name, image, asked.parsed.calibration, prompts, min_score=min_score, times=times
        )
    except CalibrationError as error:
        raise CalibrationError(f"{asked.calib_field}.P2", error.problem, error.remedy) from None
    return labels, (image.shape[1], image.shape[0])
