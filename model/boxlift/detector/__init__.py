"""2D objects in an image, found by an ONNX model: the one in this package or a user's own.

docs/detectors.md describes what a file must offer; weights/README.md where ours comes from.
"""

from boxlift.detector.detector import DEFAULT_FILE, INTERFACE, Detections, Detector
from boxlift.detector.frames import find_prompts

__all__ = ["DEFAULT_FILE", "INTERFACE", "Detections", "Detector", "find_prompts"]
