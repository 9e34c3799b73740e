"""One image and its camera in, 3D boxes out: the monocular model, run by ONNX Runtime.

The model that ships, and any other that follows `interface.MONOCULAR`, is an ONNX file; how ours was trained
is told in `network/`.
"""

from boxlift.monocular.interface import MONOCULAR
from boxlift.monocular.model import DEFAULT_PATH, Monocular

__all__ = ["DEFAULT_PATH", "MONOCULAR", "Monocular"]
