"""An image in, classes, 2D boxes, scores and perhaps masks out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boxlift.errors import ImageError, ModelFileError
from boxlift.formats.image import resized
from boxlift.frame import Prompt
from boxlift.onnx_model import Interface, OnnxModel, Tensor
from boxlift.settings import DetectionSettings

DEFAULT_FILE = Path(__file__).parent / "weights" / "nanodet_g.onnx"

_REMEDY = "docs/detectors.md describes what the file of a detector must offer."
INTERFACE = Interface(
    inputs=(Tensor("image", "uint8", ("H", "W", 3)),),
    outputs=(
        Tensor("boxes_px", "float32", ("N", 4)),
        Tensor("scores", "float32", ("N",)),
        Tensor("categories", "int64", ("N",)),
        Tensor("masks", ("bool", "uint8", "float32"), ("N", "H", "W"), optional=True),
    ),
    metadata={"classes": None},
    remedy=_REMEDY,
)

# No street holds as many: above it the model has forgotten its NMS, and every box would cost a fit.
_MOST_DETECTIONS = 1_000
_LEAST_SIDE_PX = 32
# As labels are written, so that a detection is what its label says: hundredths of a pixel, four decimals.
_PIXEL_DECIMALS, _SCORE_DECIMALS = 2, 4


@dataclass(frozen=True)
class Detections:
    """What a detector sees in one image, the highest score first.

    prompts: boxes lie inside the image and have an area; their classes are the detector's own.
    instance_ids: (H, W) index in `prompts` + 1 of the object that a pixel belongs to, 0 for none; where
    masks overlap, the higher score's. None from a detector without masks.
    """

    prompts: tuple[Prompt, ...]
    instance_ids: NDArray[np.uint16] | None = None


class Detector:
    """A detector's model file. Threads may share one; equal images give equal detections."""

    def __init__(self, model: OnnxModel) -> None:
        self._model = model
        self.class_names = model.class_names()
        self._longest_side_px = self._longest_side()

    @classmethod
    def open(cls, path: Path | str | None = None, threads: int = 1) -> Detector:
        """The detector in this package, or the one in the file `path`, computing in `threads` threads.

        Raises ModelFileError where the file is not a detector's, MissingExtraError without ONNX Runtime.
        """
        return cls(OnnxModel.open(DEFAULT_FILE if path is None else path, INTERFACE, threads))

    @property
    def name(self) -> str:
        """The file's name without its suffix."""
        return self._model.path.stem

    @property
    def digest(self) -> str:
        """SHA-256 of the file, hexadecimal."""
        return self._model.digest

    def detect(
        self, image: NDArray[np.uint8], min_score: float = DetectionSettings().min_score
    ) -> Detections:
        """What is in an (H, W, 3) RGB image with at least this score.

        Boxes are clipped to the image; those with nothing inside it are left out. Raises ImageError where
        the array is no image, ModelFileError where the model fails or its numbers are no detections.
        """
        if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
            raise ImageError(
                "image", f"the array is {image.dtype} {image.shape}.", "Give uint8 (H, W, 3), RGB."
            )
        seen = self._scaled_down(image)
        found = self._model.run({"image": np.ascontiguousarray(seen)})
        boxes_px, scores, categories = (found[name] for name in ("boxes_px", "scores", "categories"))
        self._check(boxes_px, scores, categories, seen)
        height, width = image.shape[:2]
        scale = np.tile((width / seen.shape[1], height / seen.shape[0]), 2)
        boxes_px = (boxes_px * scale).clip(0, (width, height, width, height)).round(_PIXEL_DECIMALS)
        scores = scores.astype(float).round(_SCORE_DECIMALS)
        kept = np.flatnonzero((scores >= min_score) & (boxes_px[:, 2:] > boxes_px[:, :2]).all(axis=1))
        if len(kept) > _MOST_DETECTIONS:
            raise self._error(
                f"it gives {len(kept)} detections with a score of at least {min_score:g} in one image; "
                f"{_MOST_DETECTIONS} are possible, after its own non-maximum suppression."
            )
        kept = kept[np.argsort(-scores[kept], kind="stable")]
        prompts = tuple(
            Prompt(self.class_names[category], (x1, y1, x2, y2), score)
            for category, (x1, y1, x2, y2), score in zip(
                categories[kept].tolist(), boxes_px[kept].tolist(), scores[kept].tolist(), strict=True
            )
        )
        masks = found.get("masks")
        return Detections(prompts, None if masks is None else _instance_ids(masks, kept, (height, width)))

    def _longest_side(self) -> int | None:
        """The property longest_side_px. Raises ModelFileError."""
        text = self._model.metadata.get("longest_side_px")
        if text is None:
            return None
        if not (text.isascii() and text.isdigit() and len(text) < 10 and int(text) >= _LEAST_SIDE_PX):
            raise self._error(
                f"its property 'longest_side_px' is {text!r:.40}, no number of at least {_LEAST_SIDE_PX}."
            )
        return int(text)

    def _scaled_down(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The image, or a smaller one where it is larger than this detector was made for."""
        height, width = image.shape[:2]
        longest = max(height, width)
        if self._longest_side_px is None or longest <= self._longest_side_px:
            return image
        scale = self._longest_side_px / longest
        return resized(image, (max(1, round(width * scale)), max(1, round(height * scale))))

    def _check(
        self, boxes_px: NDArray[Any], scores: NDArray[Any], categories: NDArray[Any], image: NDArray[np.uint8]
    ) -> None:
        """Raises ModelFileError for numbers that mean something else than the interface says."""
        if not (np.isfinite(boxes_px).all() and (boxes_px[:, 2:] >= boxes_px[:, :2]).all()):
            raise self._error("some of its boxes_px are no x1, y1, x2, y2 with x1 <= x2 and y1 <= y2.")
        if len(boxes_px) and boxes_px.max() <= 1 and min(image.shape[:2]) > 1:
            raise self._error("its boxes_px lie between 0 and 1; pixels of the image are needed.")
        if not ((scores >= 0) & (scores <= 1)).all():
            raise self._error("some of its scores lie outside 0 to 1; probabilities are needed.")
        if not ((categories >= 0) & (categories < len(self.class_names))).all():
            raise self._error(
                f"some of its categories are no index of the {len(self.class_names)} names in its property "
                "'classes'."
            )

    def _error(self, problem: str) -> ModelFileError:
        return ModelFileError(str(self._model.path), problem, _REMEDY)


def _instance_ids(masks: NDArray[Any], kept: NDArray[np.intp], shape: tuple[int, int]) -> NDArray[np.uint16]:
    """(N, h, w) masks and those that are kept, best first -> `shape` (H, W): place among the kept + 1."""
    _, height, width = masks.shape
    instance_ids = np.zeros((height, width), np.uint16)
    for place in range(len(kept) - 1, -1, -1):
        instance_ids[masks[kept[place]] > 0.5] = place + 1
    rows, columns = _nearest(shape[0], height), _nearest(shape[1], width)
    enlarged: NDArray[np.uint16] = instance_ids[rows[:, None], columns]
    return enlarged


def _nearest(side_px: int, smaller_px: int) -> NDArray[np.intp]:
    """(side_px,) which of `smaller_px` pixels each pixel of a side lies in."""
    return np.arange(side_px) * smaller_px // side_px
