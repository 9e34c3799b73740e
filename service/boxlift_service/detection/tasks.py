"""What the process with the models is asked to do: plain data on its way there, work once it is there."""

from __future__ import annotations

import math
import os
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
from boxlift_service.bodies.shared_parts import PartsIndex
from boxlift_service.detection.decoding import ImageRequest, decode_detect_request
from boxlift_service.detection.models import Models
from boxlift_service.options import labeller_settings
from boxlift_service.settings import ServiceSettings


@dataclass(frozen=True)
class FoundPrompts:
    """What a detector found, and its digest; masks: where they lie in the shared memory, and their shape."""

    prompts: tuple[Prompt, ...]
    model_digest: str
    masks: tuple[int, tuple[int, ...]] | None

    def read_instance_ids(self, file: int) -> NDArray[np.uint16] | None:
        """(H, W) prompt index + 1; None where the detector has no masks."""
        if self.masks is None:
            return None
        start, shape = self.masks
        data = os.pread(file, 2 * math.prod(shape), start)
        return np.frombuffer(data, np.uint16).reshape(shape)


@dataclass(frozen=True)
class FindPromptsTask:
    """POST /label without prompts: what is found in the image among the parts, as its options have it."""

    parts: PartsIndex

    def __call__(self, models: Models, file: int) -> FoundPrompts:
        """Raises ImageError, OptionsError, NoModelError, ModelFileError. Writes masks behind the parts."""
        detector, limits = models.require_detector(), models.settings
        parts = {name: parts[0] for name, parts in self.parts.read(file).items()}
        settings = labeller_settings(parts.get("options"), models.presets)
        image = decode_image(parts["image"].data, max_pixels=limits.max_image_pixels)
        found = detector.detect(image, settings.detection.min_score)
        masks = None
        if found.instance_ids is not None:
            ids = np.ascontiguousarray(found.instance_ids, np.uint16)
            masks = os.fstat(file).st_size, ids.shape
            os.pwrite(file, ids.data, masks[0])
        # The best come first.
        return FoundPrompts(found.prompts[: limits.max_prompts], detector.digest, masks)


@dataclass(frozen=True)
class DetectedImages:
    """The body of an answer, how many objects had which result, and the seconds per stage of all images."""

    content: bytes
    results: Counter[str]
    seconds: dict[str, float]


@dataclass(frozen=True)
class DetectTask:
    """POST /detect: find the objects of the images among the parts."""

    parts: PartsIndex
    as_text: bool

    def __call__(self, models: Models, file: int) -> DetectedImages:
        """Raises InputError that names the field at fault, NoModelError, ModelFileError."""
        monocular = models.require_monocular()
        parts = self.parts.read(file)
        request = decode_detect_request(parts, models.settings)
        detector = models.detector_of_images() if "prompts" not in parts else None
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
        results = Counter(label.result.name for labels, _ in found for label in labels.objects)
        return DetectedImages(content.encode(), results, {**seconds, **times.seconds})


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
