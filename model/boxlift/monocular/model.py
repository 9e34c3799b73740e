"""The monocular model: an image in, labels out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Calibration, Floats
from boxlift.errors import CalibrationError, ImageError, ModelFileError
from boxlift.frame import FrameLabels, FrameWarning, ObjectLabel, Prompt, Result, RigDoubt
from boxlift.monocular.interface import MONOCULAR
from boxlift.monocular.rows import Rows, label_of_row
from boxlift.monocular.view import View, view_of
from boxlift.object_points import check_box
from boxlift.onnx_model import OnnxModel
from boxlift.rig_check import camera_doubts
from boxlift.stage_times import StageTimes

DEFAULT_PATH = Path(__file__).with_name("weights") / "monocular.onnx"


class Monocular:
    """A model file with the interface MONOCULAR. Threads may share one.

    classes: names of what it knows. name: of its file.
    """

    def __init__(self, model: OnnxModel) -> None:
        self._model = model
        self.name = model.path.stem
        self.digest = model.digest
        self.metadata = model.metadata
        self.classes = model.class_names()
        self._focal_px = _focal_px(model)
        self._knows_front = model.metadata.get("heading_period") == "2pi"

    @classmethod
    def open(cls, path: Path | None = None, threads: int = 1) -> Monocular:
        """The model of a file, by default the one that ships; it computes in `threads` threads.

        Raises ModelFileError where the file is no such model, MissingExtraError without ONNX Runtime.
        """
        return cls(OnnxModel.open(path or DEFAULT_PATH, MONOCULAR, threads))

    def detect(
        self,
        name: str,
        image: NDArray[np.uint8],
        calibration: Calibration,
        prompts: Sequence[Prompt] | None = None,
        *,
        min_score: float = 0.0,
        times: StageTimes | None = None,
    ) -> FrameLabels:
        """A 3D box for each prompt, or the sentence why there is none; without prompts for what it finds.

        image: (H, W, 3) uint8 RGB, rectified. Of `calibration` only the camera counts. What the model finds
        with a score below `min_score` is left out; prompts never are. The image is resized to the focal
        length that the model knows and to at most view.MOST_PIXELS.

        Raises ImageError for an array that is no such image, CalibrationError for a projection that
        cannot be of this image, ModelFileError where the model fails.
        """
        times = times or StageTimes()
        size_px = _image_size(image)
        warnings = _camera_warnings(calibration, size_px)
        with times.stage("resize"):
            view = view_of(np.ascontiguousarray(image), calibration, self._focal_px)
        if prompts is None:
            with times.stage("network"):
                rows = self._run(view, np.empty((0, 4)), [], size_px)
            objects = self._found(rows, size_px, min_score)
        else:
            objects = self._lifted(view, tuple(prompts), size_px, times)
        return FrameLabels(name, objects, warnings)

    def _found(self, rows: Rows, size_px: tuple[int, int], min_score: float) -> tuple[ObjectLabel, ...]:
        """What the model found by itself, in its order."""
        objects: list[ObjectLabel] = []
        for row in range(len(rows)):
            prompt = self._prompt_of_row(rows, row, size_px)
            label = label_of_row(rows, row, len(objects), prompt)
            if label.box is None or label.score >= min_score:
                objects.append(label)
        return tuple(objects)

    def _lifted(
        self, view: View, prompts: tuple[Prompt, ...], size_px: tuple[int, int], times: StageTimes
    ) -> tuple[ObjectLabel, ...]:
        """One entry per prompt, in their order; the model sees only those that it can use."""
        objects = {index: self._refusal(prompt, index, size_px) for index, prompt in enumerate(prompts)}
        usable = [index for index, refusal in objects.items() if refusal is None]
        if usable:
            boxes_px = _clipped(np.array([prompts[index].box_px for index in usable]), size_px)
            categories = [self.classes.index(prompts[index].category) for index in usable]
            with times.stage("network"):
                rows = self._run(view, boxes_px, categories, size_px)
            for row, index in enumerate(usable):
                objects[index] = label_of_row(rows, row, index, prompts[index], prompts[index].score)
        return tuple(label for label in objects.values() if label is not None)

    def _refusal(self, prompt: Prompt, index: int, size_px: tuple[int, int]) -> ObjectLabel | None:
        """The label of a prompt that the model cannot use; None for any other."""
        if prompt.category not in self.classes:
            result = Result.CLASS_NOT_IN_MODEL
            sentence = result.value.format(category=prompt.category, known=", ".join(self.classes))
            return ObjectLabel(index, prompt, result, sentence)
        unusable = check_box(prompt, index, size_px)
        return None if unusable is None else ObjectLabel(index, prompt, unusable.result, unusable.sentence)

    def _run(
        self, view: View, prompt_boxes_px: Floats, prompt_categories: Sequence[int], size_px: tuple[int, int]
    ) -> Rows:
        """Boxes go in and come out in pixels of the original image."""
        answers = self._model.run(
            {
                "image": view.image,
                "image_P_cam": view.image_P_cam.astype(np.float32),
                "prompt_boxes_px": view.boxes_in_view(prompt_boxes_px).astype(np.float32),
                "prompt_categories": np.array(prompt_categories, dtype=np.int64),
            }
        )
        count = len(answers["boxes_px"])
        if prompt_categories and count != len(prompt_categories):
            raise self._error(f"it gives {count} rows for {len(prompt_categories)} prompts.")
        answers["boxes_px"] = view.boxes_in_original(answers["boxes_px"].astype(np.float64))
        return Rows(**answers, image_size_px=size_px, knows_front=self._knows_front)

    def _prompt_of_row(self, rows: Rows, row: int, size_px: tuple[int, int]) -> Prompt:
        """A found object's 2D part; a box that is no numbers is told by label_of_row."""
        category = int(rows.categories[row])
        if not 0 <= category < len(self.classes):
            raise self._error(f"it gives the class number {category}, and names {len(self.classes)} classes.")
        x1, y1, x2, y2 = _clipped(np.nan_to_num(rows.boxes_px[row]), size_px).tolist()
        score = float(np.nan_to_num(rows.detection_scores[row]).clip(0, 1))
        return Prompt(self.classes[category], (x1, y1, x2, y2), score)

    def _error(self, problem: str) -> ModelFileError:
        return ModelFileError(str(self._model.path), problem, MONOCULAR.remedy)


def _image_size(image: NDArray[np.uint8]) -> tuple[int, int]:
    """(width, height) of an image that is one. Raises ImageError."""
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or image.size == 0:
        raise ImageError(
            "image", f"the array is {image.dtype} {image.shape}.", "Give RGB as uint8 (height, width, 3)."
        )
    return image.shape[1], image.shape[0]


def _camera_warnings(calibration: Calibration, size_px: tuple[int, int]) -> tuple[FrameWarning, ...]:
    """Doubts about the camera. Raises CalibrationError where there is no doubt: no lens is like that."""
    warnings = tuple(camera_doubts(calibration, size_px))
    for warning in warnings:
        if warning.doubt is RigDoubt.FOCAL_LENGTH:
            problem, _, remedy = warning.sentence.partition(". ")
            raise CalibrationError("image_P_cam", f"{problem}.", remedy)
    return warnings


def _clipped(boxes_px: Floats, size_px: tuple[int, int]) -> Floats:
    """(..., 4) boxes, cut to the pixel centres of the image."""
    right, bottom = size_px[0] - 1, size_px[1] - 1
    return boxes_px.clip(0, [right, bottom, right, bottom])


def _focal_px(model: OnnxModel) -> float:
    """The property focal_px. Raises ModelFileError where it is no focal length."""
    text = model.metadata["focal_px"]
    try:
        focal_px = float(text)
    except ValueError:
        focal_px = math.nan
    if not 1 <= focal_px <= 100_000:
        problem = f"its property 'focal_px' is {text!r:.60}, no focal length in pixels."
        raise ModelFileError(str(model.path), problem, MONOCULAR.remedy)
    return focal_px
