"""An image as the model sees it: at the focal length that it knows, and not too large.

Appearance tells a network depth at one focal length only: a car 20 m away is as tall as one at 40 m through a
lens of twice the focal length. Scaled to one focal length (square pixels), all cameras look alike; the
projection is scaled with the image, so that nothing geometric changes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Calibration, Floats
from boxlift.formats.image import resized

# A focal length this near is taken as it is: resampling would cost time and sharpness for nothing.
_NEAR = 0.05
# Whatever comes in, the model sees no more than this: 4.3 times the pixels of a KITTI image, and so at most
# about 4.3 times its time. Larger ones are shrunk beyond the model's focal length, and lose what is far away.
MOST_PIXELS = 2_000_000
_LONGEST_SIDE_PX, _SHORTEST_SIDE_PX = 8192, 32


@dataclass(frozen=True)
class View:
    """image: (H, W, 3) uint8 RGB; image_P_cam: (3, 4) its projection; scale: its pixels per pixel (x, y)."""

    image: NDArray[np.uint8]
    image_P_cam: Floats
    scale: tuple[float, float]

    def boxes_in_view(self, boxes_px: Floats) -> Floats:
        """(N, 4) x1, y1, x2, y2 in pixels of the original -> in pixels of the view."""
        scale = np.array([*self.scale, *self.scale])
        in_view: Floats = boxes_px * scale + (scale - 1) / 2
        return in_view

    def boxes_in_original(self, boxes_px: Floats) -> Floats:
        """Inverse of boxes_in_view."""
        scale = np.array([*self.scale, *self.scale])
        in_original: Floats = (boxes_px - (scale - 1) / 2) / scale
        return in_original


def view_of(image: NDArray[np.uint8], calibration: Calibration, focal_px: float) -> View:
    """(H, W, 3) uint8 RGB -> the view at `focal_px`, or as near to it as MOST_PIXELS lets it be.

    Raises MissingExtraError where an image has to be resized without Pillow.
    """
    height, width = image.shape[:2]
    focal_x, focal_y = calibration.focal_px
    wanted_width, wanted_height = width * focal_px / focal_x, height * focal_px / focal_y
    if _is_near(wanted_width, width) and _is_near(wanted_height, height):
        wanted_width, wanted_height = float(width), float(height)
    shrink = min(
        1.0,
        math.sqrt(MOST_PIXELS / (wanted_width * wanted_height)),
        _LONGEST_SIDE_PX / max(wanted_width, wanted_height),
    )
    new_width, new_height = (
        max(_SHORTEST_SIDE_PX, round(shrink * side)) for side in (wanted_width, wanted_height)
    )
    if (new_width, new_height) == (width, height):
        return View(image, calibration.image_P_cam, (1.0, 1.0))
    scale_x, scale_y = new_width / width, new_height / height
    # Pixel centres are whole numbers: u' + 1/2 = scale (u + 1/2).
    image_from_image = np.array([[scale_x, 0, (scale_x - 1) / 2], [0, scale_y, (scale_y - 1) / 2], [0, 0, 1]])
    return View(
        resized(image, (new_width, new_height)),
        image_from_image @ calibration.image_P_cam,
        (scale_x, scale_y),
    )


def _is_near(wanted: float, given: float) -> bool:
    return abs(wanted - given) <= _NEAR * given
