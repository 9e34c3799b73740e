"""A frame's prompts from its image."""

from __future__ import annotations

from dataclasses import replace

from boxlift.detector.detector import Detector
from boxlift.errors import ImageError
from boxlift.frame import Frame
from boxlift.settings import DetectionSettings


def find_prompts(frame: Frame, detector: Detector, settings: DetectionSettings) -> Frame:
    """The frame with what `detector` sees in its image as prompts, and masks where the detector gives them.

    Raises ImageError where the frame has no image, ModelFileError as Detector.detect does.
    """
    if frame.image is None:
        raise ImageError(
            "image", f"frame {frame.name!r} has no image to find objects in.", "Add it, or give 2D boxes."
        )
    found = detector.detect(frame.image, settings.min_score)
    return replace(frame, prompts=found.prompts, instance_ids=found.instance_ids)
