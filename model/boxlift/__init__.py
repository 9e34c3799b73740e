"""boxlift: 3D boxes from 2D boxes and LiDAR, without a drawn 3D label.

The craft knows no HTTP and no command line. Importing it needs numpy and pydantic only; torch and
Open3D load where they are used.
"""

from boxlift.boxes import Boxes3D
from boxlift.camera import Calibration
from boxlift.errors import BoxliftError, InputError, MissingExtraError
from boxlift.frame import Frame, FrameLabels, ObjectLabel, Prompt, Result
from boxlift.settings import LabellerSettings, preset

__version__ = "0.1.0"

__all__ = [
    "Boxes3D",
    "BoxliftError",
    "Calibration",
    "Frame",
    "FrameLabels",
    "InputError",
    "LabellerSettings",
    "MissingExtraError",
    "ObjectLabel",
    "Prompt",
    "Result",
    "__version__",
    "preset",
]
