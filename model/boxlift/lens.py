"""Lenses that bend straight lines, and images made straight again.

boxlift thinks in rectified cameras: a point of the camera frame goes to a pixel by a 3 x 4 matrix. An image
whose calibration has distortion coefficients is rectified with OpenCV before anything looks at it, and 2D
boxes that were drawn on it move along. The rectified image keeps size, focal length and principal point, so
that what a wide lens sees at its border is cut off.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boxlift.errors import CalibrationError, MissingExtraError
from boxlift.poses import Floats

# OpenCV's models under the names that ROS and Foxglove have for them, and their numbers of coefficients:
# k1 k2 p1 p2 [k3]; k1 k2 p1 p2 k3 k4 k5 k6; k1 k2 k3 k4 of the fisheye (Kannala and Brandt, 2006).
_COEFFICIENTS = {"plumb_bob": (4, 5), "rational_polynomial": (8,), "kannala_brandt": (4,)}
_OTHER_NAMES = {"fisheye": "kannala_brandt", "equidistant": "kannala_brandt", "brown_conrady": "plumb_bob"}
# Points on each side of a 2D box that are followed through the lens.
_POINTS_A_SIDE = 9


@dataclass(frozen=True)
class Lens:
    """A pinhole with distortion.

    image_K_cam: ((fx, 0, cx), (0, fy, cy), (0, 0, 1)), pixels. model: a key of OpenCV's models as ROS names
    them; coefficients in OpenCV's order. Raises CalibrationError where boxlift cannot rectify such a lens.
    """

    image_K_cam: tuple[tuple[float, ...], ...]
    model: str
    coefficients: tuple[float, ...]

    def __post_init__(self) -> None:
        model = _OTHER_NAMES.get(self.model, self.model)
        object.__setattr__(self, "model", model)
        if model not in _COEFFICIENTS:
            raise CalibrationError(
                "distortion_model",
                f"{self.model!r:.40} is not known (known: {', '.join(_COEFFICIENTS)}).",
                "Rectify the images, and leave the distortion out.",
            )
        if len(self.coefficients) not in _COEFFICIENTS[model]:
            wanted = " or ".join(str(count) for count in _COEFFICIENTS[model])
            raise CalibrationError(
                "distortion",
                f"{model} has {len(self.coefficients)} coefficients here.",
                f"Give {wanted}, in OpenCV's order.",
            )
        if not np.isfinite(self.coefficients).all():
            raise CalibrationError("distortion", "a coefficient is not finite.", "Give numbers.")

    @classmethod
    def of(cls, image_P_cam: Floats, model: str, coefficients: Sequence[float]) -> Lens | None:
        """The lens of a camera; None where it is straight: without a model, or with zeros alone.

        Raises CalibrationError.
        """
        if not model or not any(coefficients):
            return None
        rows = tuple(tuple(float(value) for value in row[:3]) for row in image_P_cam)
        return cls(rows, model, tuple(float(value) for value in coefficients))

    def rectified_image(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """(H, W, 3) as the camera wrote it -> (H, W, 3) as a pinhole would have seen it; black beyond."""
        return self._remapped(image, linear=True)

    def rectified_ids(self, instance_ids: NDArray[np.unsignedinteger]) -> NDArray[np.uint16]:
        """(H, W) masks of the camera's image -> of the rectified one; 0 beyond."""
        return self._remapped(instance_ids.astype(np.uint16), linear=False)

    def rectified_box(
        self, box_px: tuple[float, float, float, float], size_px: tuple[int, int]
    ) -> tuple[float, float, float, float]:
        """A 2D box of the camera's image -> around the same outline in the rectified one, cut to it.

        A box that is no box stays as it is, for the labeller to say so.
        """
        x1, y1, x2, y2 = box_px
        if not (np.isfinite(box_px).all() and x1 < x2 and y1 < y2):
            return box_px
        along = np.linspace(0, 1, _POINTS_A_SIDE)
        across, down = x1 + along * (x2 - x1), y1 + along * (y2 - y1)
        outline = np.concatenate(
            [np.column_stack([across, np.full_like(across, y)]) for y in (y1, y2)]
            + [np.column_stack([np.full_like(down, x), down]) for x in (x1, x2)]
        )
        pixels = self.rectified_pixels(outline)
        limit = np.array(size_px, dtype=np.float64) - 1
        low, high = pixels.min(axis=0).clip(0, limit), pixels.max(axis=0).clip(0, limit)
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    def rectified_pixels(self, pixels: Floats) -> Floats:
        """(N, 2) pixels of the camera's image -> of the rectified one."""
        cv2, matrix, coefficients = _cv2(), np.array(self.image_K_cam), np.array(self.coefficients)
        points = pixels.reshape(-1, 1, 2).astype(np.float64)
        if self.model == "kannala_brandt":
            straight = cv2.fisheye.undistortPoints(points, matrix, coefficients, P=matrix)
        else:
            straight = cv2.undistortPoints(points, matrix, coefficients, P=matrix)
        return np.asarray(straight, dtype=np.float64).reshape(-1, 2)

    def _remapped(self, image: NDArray[Any], *, linear: bool) -> NDArray[Any]:
        cv2 = _cv2()
        height, width = image.shape[:2]
        rows, columns = _maps(self, (width, height))
        method = cv2.INTER_LINEAR if linear else cv2.INTER_NEAREST
        return np.asarray(cv2.remap(image, rows, columns, method))


@functools.lru_cache(maxsize=16)
def _maps(lens: Lens, size_px: tuple[int, int]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Where each pixel of the rectified image is in the camera's."""
    cv2, matrix, coefficients = _cv2(), np.array(lens.image_K_cam), np.array(lens.coefficients)
    of_model = cv2.fisheye if lens.model == "kannala_brandt" else cv2
    rows, columns = of_model.initUndistortRectifyMap(
        matrix, coefficients, np.eye(3), matrix, size_px, cv2.CV_32FC1
    )
    return rows, columns


def _cv2() -> Any:
    try:
        import cv2
    except ImportError:
        raise MissingExtraError("opencv-python-headless", "datasets") from None
    return cv2
