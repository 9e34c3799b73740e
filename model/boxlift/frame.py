"""What goes into a labeller and what comes out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from boxlift.boxes import Boxes3D
from boxlift.camera import Calibration
from boxlift.errors import ImageError, PointCloudError, PromptError
from boxlift.lens import Lens
from boxlift.sweep import SweepView


@dataclass(frozen=True)
class Prompt:
    """A 2D object to be lifted: class name, box (x1, y1, x2, y2) in pixels, score of its detector.

    Whether a prompt can be used (known class, box not empty and inside the image) is found out by the
    labeller and told in its result; a prompt itself never raises.
    """

    category: str
    box_px: tuple[float, float, float, float]
    score: float = 1.0


@dataclass(frozen=True)
class Frame:
    """One moment of one camera and one LiDAR.

    name: any name; together with a prompt's index it seeds every random choice.
    points_velo: (N, 3+) finite float points in the LiDAR frame, metres; further columns are ignored.
    image_size_px: (width, height).
    prompts: what to label.
    image: (H, W, 3) uint8 RGB, where there is one.
    instance_ids: (H, W) unsigned integers where there are masks: prompt index + 1, 0 is no object.
    view: where it belongs among the cameras and sweeps of its data set; no labeller asks.
    lens: what image and masks were rectified from, where they were: 2D boxes of the camera's own image must
    go through it. `calibration` is the rectified camera's.

    Raises PointCloudError, ImageError or PromptError where an array has the wrong shape.
    """

    name: str
    points_velo: NDArray[np.floating]
    calibration: Calibration
    image_size_px: tuple[int, int]
    prompts: tuple[Prompt, ...] = ()
    image: NDArray[np.uint8] | None = None
    instance_ids: NDArray[np.unsignedinteger] | None = None
    view: SweepView | None = None
    lens: Lens | None = None

    def __post_init__(self) -> None:
        if self.points_velo.ndim != 2 or self.points_velo.shape[1] < 3:
            raise PointCloudError(
                "points", f"the array has shape {self.points_velo.shape}.", "Give one row x, y, z per point."
            )
        width, height = self.image_size_px
        if self.image is not None and self.image.shape != (height, width, 3):
            raise ImageError(
                "image",
                f"the array has shape {self.image.shape}, image_size is {width} x {height}.",
                "Give an RGB image of that size.",
            )
        if self.instance_ids is not None and self.instance_ids.shape != (height, width):
            mask_height, mask_width = self.instance_ids.shape[:2]
            raise PromptError(
                "masks",
                f"the mask image is {mask_width} x {mask_height}, the image {width} x {height} pixels.",
                "Give masks of the image's size.",
            )


class Result(Enum):
    """How one prompt ended; the value is the sentence that a user reads (some with values to fill in)."""

    FITTED = "A box was fitted."
    UNKNOWN_CLASS = "The class {category!r} has no size prior (known: {known}); declare one in a priors file."
    BAD_BOX = "The 2D box {box} has no area or absurd numbers; x2 > x1 and y2 > y1 in pixels are needed."
    BOX_OUTSIDE_IMAGE = "The 2D box {box} lies outside the image ({width} x {height} pixels)."
    EMPTY_MASK = "No pixel of the mask image inside the 2D box belongs to this prompt (prompt index + 1)."
    NO_LIDAR = "The frame has no LiDAR points."
    TOO_FEW_POINTS = "Too few LiDAR points inside the 2D {region} ({found}, at least {needed} are needed)."
    TOO_FEW_OBJECT_POINTS = (
        "Too few LiDAR points left on the object after ground removal and clustering "
        "({found} of {initial}, at least {needed} are needed)."
    )
    NO_OBJECT_POINTS = (
        "None of the {initial} LiDAR points inside the 2D {region} can be the object's: they are ground, too "
        "high above it, or belong to nearer objects (at least {needed} are needed)."
    )
    NO_OBJECT = (
        "Nothing here looks like a {category}: what the camera and the LiDAR saw disagrees ({reason})."
    )
    TRACKED = "Other frames of the drive show this object."
    FILLED = (
        "There is no prompt here, but other frames of the drive show an object, and LiDAR points lie on it."
    )
    CORRECTED = "A reviewer gave this box."
    REJECTED = "A reviewer rejected the box."
    PREDICTED = "The model predicted a box."
    CLASS_NOT_IN_MODEL = "The model does not know the class {category!r} (it knows {known})."
    ABSURD_PREDICTION = "What the model gave for this object is no 3D box ({reason})."


class RigDoubt(Enum):
    """What the data say against a calibration; the value is the sentence, with values to fill in."""

    FOCAL_LENGTH = (
        "The focal lengths {fx:g} and {fy:g} would give {width} pixels a view of {view:.0f} degrees. "
        "Give them in pixels of this image."
    )
    IMAGE_SIZE = (
        "The principal point ({cx:.0f}, {cy:.0f}) belongs to an image of about {calibrated} pixels, this one "
        "has {given}. Scale the projection with the image, or give the image that was calibrated."
    )
    LIDAR_FAR_AWAY = (
        "The LiDAR would be {distance:.0f} m away from the camera. Give the translation in metres."
    )
    TILTED = (
        "The {what} leans {tilt:.0f} degrees against the camera's horizontal (x right, y down, z forward). "
        "Check the rotation from LiDAR to camera. {guess}"
    )
    CAMERA_HEIGHT = (
        "The camera would be {height:.1f} m above the ground. "
        "Check the translation from LiDAR to camera and its unit (metres)."
    )
    NOTHING_IN_VIEW = (
        "Only {seen} of {total} LiDAR points fall into the image. "
        "Check that calibration, image and points are of the same camera."
    )
    PROMPTS_OUTSIDE_IMAGE = (
        "{outside} of {total} 2D boxes lie outside the image ({given} pixels). "
        "Give boxes in pixels of this image."
    )
    PROMPTS_WITHOUT_OBJECTS = (
        "{empty} of {total} 2D boxes hold no object at the distance that class and height in pixels ask for. "
        "Check that calibration, image, points and boxes are of the same camera and moment."
    )


@dataclass(frozen=True)
class FrameWarning:
    """A doubt about the rig of a frame, and the sentence that a user reads."""

    doubt: RigDoubt
    sentence: str


@dataclass(frozen=True)
class LossTerms:
    """Means over the object points of the loss at the fitted box, metres; `total` is what was minimised."""

    geometric: float
    ray_tracing: float
    center: float
    total: float


@dataclass(frozen=True)
class PointCounts:
    """Points after each step, from the prompt's region to those that the losses see.

    `used` are drawn from the cluster; with replacement (release) they may outnumber it.
    """

    in_prompt: int = 0
    above_ground: int = 0
    in_cluster: int = 0
    used: int = 0


@dataclass(frozen=True)
class Hypothesis:
    """A box that was fitted and not chosen; no losses where it had too few points for a fit of its own."""

    box: Boxes3D
    losses: LossTerms | None
    reason: str


@dataclass(frozen=True)
class ObjectLabel:
    """What became of one prompt: a box (`box` has length 1) or, with no box, the sentence why not.

    iou_probability: calibrated, that the 3D IoU with the truth exceeds .5 and .7; None in the presets that
    have none. depth_spread: relative standard deviation of the depth that a model predicted; None where
    LiDAR gave it.
    """

    index: int
    prompt: Prompt
    result: Result
    sentence: str
    box: Boxes3D | None = None
    score: float = 0.0
    flags: tuple[str, ...] = ()
    losses: LossTerms | None = None
    points: PointCounts = field(default_factory=PointCounts)
    rejected: tuple[Hypothesis, ...] = ()
    iou_probability: tuple[float, float] | None = None
    depth_spread: float | None = None


@dataclass(frozen=True)
class FrameLabels:
    """The labels of one frame: one entry per prompt, in their order, and doubts about the frame's rig."""

    frame_name: str
    objects: tuple[ObjectLabel, ...]
    warnings: tuple[FrameWarning, ...] = ()

    @classmethod
    def without_boxes(cls, frame_name: str, prompts: Sequence[Prompt], result: Result) -> FrameLabels:
        """Labels that say the same of every prompt: `result`, whose sentence has nothing to fill in."""
        objects = (ObjectLabel(i, prompt, result, result.value) for i, prompt in enumerate(prompts))
        return cls(frame_name, tuple(objects))

    @property
    def fitted(self) -> Sequence[ObjectLabel]:
        """The objects that have a box."""
        return [label for label in self.objects if label.box is not None]

    def counts(self) -> dict[str, int]:
        """Objects per result name, e.g. {"FITTED": 4, "TOO_FEW_POINTS": 1}."""
        names = [label.result.name for label in self.objects]
        return {result.name: names.count(result.name) for result in Result if result.name in names}
