"""Details of a labelled frame as JSON: the one schema of details/STEM.json and of the HTTP answer.

Metres and radians are rounded to four decimals and pixels to two, so that the same labels are the same
bytes. KITTI's own numbers are rounded as KITTI writes them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import AliasChoices, BaseModel, ConfigDict, Field

from boxlift.boxes import Boxes3D
from boxlift.formats import kitti_label
from boxlift.formats.kitti_label import KittiObject, object_of
from boxlift.frame import FrameLabels, Hypothesis, LossTerms, ObjectLabel, PointCounts
from boxlift.sweep import SweepView


class _Details(BaseModel):
    model_config = ConfigDict(frozen=True)


class BoxDetails(_Details):
    """A 3D box in the rectified camera frame (x right, y down, z forward), metres and radians."""

    center_cam: tuple[float, float, float] = Field(description="Geometric centre, metres.")
    length_m: float
    width_m: float
    height_m: float
    rotation_y: float = Field(description="About the y axis in [-pi, pi); heading is (cos, 0, -sin) of it.")


class KittiDetails(_Details):
    """The same box in KITTI's conventions: location is the centre of the BOTTOM face."""

    type: str
    truncated: float = Field(description="-1: unknown.")
    occluded: int = Field(description="-1: unknown.")
    alpha: float = Field(description="Observation angle, radians.")
    bbox: tuple[float, float, float, float] = Field(description="The prompt's box x1, y1, x2, y2, pixels.")
    dimensions: tuple[float, float, float] = Field(description="Height, width, length, metres.")
    location: tuple[float, float, float] = Field(description="Bottom centre x, y, z, metres.")
    rotation_y: float
    score: float


class LossDetails(_Details):
    """Loss terms at the box, means over the points that were used, metres."""

    geometric: float
    ray_tracing: float
    center: float
    total: float = Field(description="What was minimised.")


class PointDetails(_Details):
    """LiDAR points left after each step."""

    in_prompt: int
    above_ground: int
    in_cluster: int
    used: int


class RejectedDetails(_Details):
    """A box that was fitted and not chosen."""

    reason: str
    box: BoxDetails
    losses: LossDetails | None = Field(description="None: too few points for a fit of its own.")


class TrackDetails(_Details):
    """The track that an object is part of, see `boxlift track`."""

    id: int = Field(description="The same for the same object in all frames of its drive, from 1.")
    motion: str = Field(description="static, moving, or unknown.")
    sightings: int = Field(description="Sweeps in which it was labelled from the sweep itself.")


class ReviewDetails(_Details):
    """What somebody said about a box, in a corrected label set."""

    verdict: str = Field(description="accepted, corrected or rejected.")
    author: str
    made_at: str = Field(description="ISO 8601, with the time zone.")


class ObjectDetails(_Details):
    """What became of one prompt."""

    index: int = Field(description="Index of the prompt, from 0.")
    category: str = Field(
        serialization_alias="class",
        validation_alias=AliasChoices("category", "class"),
        description="Class of the prompt; of a track's object the one that most of its boxes have.",
    )
    prompt_box_px: tuple[float, float, float, float] = Field(description="x1, y1, x2, y2 of the prompt.")
    prompt_score: float
    result: str = Field(description="FITTED, PREDICTED, or the name of the reason why there is no box.")
    sentence: str = Field(description="The result as a sentence.")
    score: float = Field(description="Confidence in the 3D box, 0 without one.")
    iou_probability: tuple[float, float] | None = Field(
        None,
        description="Calibrated probabilities that the 3D IoU with the truth exceeds 0.5 and 0.7; only with "
        "the preset accurate, and for boxes of the frame itself.",
    )
    depth_spread: float | None = Field(
        None,
        description="Relative standard deviation of the depth that the monocular model predicted; null for "
        "boxes from LiDAR.",
    )
    flags: tuple[str, ...] = Field(description="What a reviewer should know about the box.")
    box: BoxDetails | None
    kitti: KittiDetails | None
    losses: LossDetails | None
    points: PointDetails
    rejected: tuple[RejectedDetails, ...]
    track: TrackDetails | None = Field(None, description="null: no drive was looked at.")
    review: ReviewDetails | None = Field(None, description="null: nobody reviewed it.")


class WarningDetails(_Details):
    """A doubt about the calibration of a frame, raised by its data."""

    name: str = Field(description="Name of the doubt, e.g. TILTED or IMAGE_SIZE.")
    sentence: str = Field(description="What the data say, with the numbers, and what to check.")


Matrix = tuple[tuple[float, ...], ...]


class ViewDetails(_Details):
    """Which camera's view of which sweep a frame is. The ego frame is the vehicle's, or else the LiDAR's."""

    sweep: str = Field(description="Name shared by all views of the sweep.")
    camera: str
    ego_SE3_cam: Matrix = Field(description="4 x 4, rectified camera frame to ego frame, metres.")
    log: str = Field("", description="The drive that the sweep belongs to.")
    timestamp_ns: int | None = Field(None, description="Of the sweep.")
    world_SE3_ego: Matrix | None = Field(None, description="4 x 4, ego frame to the data set's fixed frame.")


class FrameDetails(_Details):
    """What became of every prompt of a frame, in the order of the prompts."""

    frame: str
    objects: tuple[ObjectDetails, ...]
    warnings: tuple[WarningDetails, ...] = Field(
        (), description="Doubts about the calibration; labels of a frame that has any may be worthless."
    )
    model_digest: str | None = Field(
        None,
        description="SHA-256 of the file of the detector that found the prompts, or of the monocular model "
        "that predicted the boxes; null: prompts were given, and LiDAR.",
    )
    view: ViewDetails | None = Field(
        None, description="Where the frame belongs among the cameras and sweeps of its data set."
    )


def details_of(labels: FrameLabels, model_digest: str | None = None) -> FrameDetails:
    """Labels of a frame -> their details, rounded. `model_digest` is the detector's, where one was used."""
    return FrameDetails(
        frame=labels.frame_name,
        objects=tuple(object_details_of(label) for label in labels.objects),
        warnings=tuple(
            WarningDetails(name=warning.doubt.name, sentence=warning.sentence) for warning in labels.warnings
        ),
        model_digest=model_digest,
    )


def view_details_of(view: SweepView) -> ViewDetails:
    """A view -> its details, rounded to nanometres: poses may be kilometres from their origin."""
    return ViewDetails(
        sweep=view.sweep,
        camera=view.camera,
        ego_SE3_cam=_matrix(view.ego_SE3_cam),
        log=view.log,
        timestamp_ns=view.timestamp_ns,
        world_SE3_ego=None if view.world_SE3_ego is None else _matrix(view.world_SE3_ego),
    )


def _matrix(values: NDArray[np.float64]) -> Matrix:
    return tuple(tuple(round(float(value), 9) + 0.0 for value in row) for row in values)


def to_text(labels: FrameLabels) -> str:
    """Labels of a frame -> the text of details/STEM.json. Same labels, same bytes."""
    return details_of(labels).model_dump_json(by_alias=True, indent=2) + "\n"


def parse_text(text: str | bytes) -> FrameDetails:
    """The text of a details file -> its details. Raises pydantic's ValidationError."""
    return FrameDetails.model_validate_json(text)


def kitti_text(details: FrameDetails) -> str:
    """Details of a frame -> the text of data/STEM.txt: its boxes as KITTI result lines, empty for none."""
    return kitti_label.to_text(kitti_object_of(item.kitti) for item in details.objects if item.kitti)


def kitti_object_of(line: KittiDetails) -> KittiObject:
    """The KITTI part of one object's details as a result line."""
    return KittiObject(
        category=line.type,
        truncated=line.truncated,
        occluded=line.occluded,
        alpha=line.alpha,
        box_px=line.bbox,
        size_hwl_m=line.dimensions,
        bottom_center_cam=line.location,
        rotation_y=line.rotation_y,
        score=line.score,
    )


def object_details_of(label: ObjectLabel) -> ObjectDetails:
    """One prompt's label -> its details, rounded."""
    written = object_of(label)
    x1, y1, x2, y2 = (rounded(edge, 2) for edge in label.prompt.box_px)
    return ObjectDetails(
        index=label.index,
        category=label.prompt.category,
        prompt_box_px=(x1, y1, x2, y2),
        prompt_score=rounded(label.prompt.score),
        result=label.result.name,
        sentence=label.sentence,
        score=rounded(label.score),
        iou_probability=_probabilities(label),
        depth_spread=None if label.depth_spread is None else rounded(label.depth_spread),
        flags=label.flags,
        box=None if label.box is None else box_details_of(label.box),
        kitti=None if written is None else kitti_details_of(written),
        losses=None if label.losses is None else loss_details_of(label.losses),
        points=_points(label.points),
        rejected=tuple(_rejected(hypothesis) for hypothesis in label.rejected),
    )


def boxes3d_of_details(boxes: Sequence[BoxDetails]) -> Boxes3D:
    """The boxes of details, in their camera."""
    return Boxes3D(
        np.array([box.center_cam for box in boxes], dtype=np.float64).reshape(-1, 3),
        np.array([box.length_m for box in boxes], dtype=np.float64),
        np.array([box.width_m for box in boxes], dtype=np.float64),
        np.array([box.height_m for box in boxes], dtype=np.float64),
        np.array([box.rotation_y for box in boxes], dtype=np.float64),
    )


def rounded(value: float, decimals: int = 4) -> float:
    """A plain Python float without a negative zero."""
    return round(float(value), decimals) + 0.0


def box_details_of(box: Boxes3D) -> BoxDetails:
    """One box, rounded."""
    x, y, z = (rounded(axis) for axis in box.center_cam[0])
    return BoxDetails(
        center_cam=(x, y, z),
        length_m=rounded(box.length_m[0]),
        width_m=rounded(box.width_m[0]),
        height_m=rounded(box.height_m[0]),
        rotation_y=rounded(box.rotation_y[0]),
    )


def kitti_details_of(written: KittiObject) -> KittiDetails:
    """A KITTI line, rounded as KITTI rounds."""
    x1, y1, x2, y2 = (rounded(edge, 2) for edge in written.box_px)
    height, width, length = (rounded(side, 2) for side in written.size_hwl_m)
    x, y, z = (rounded(axis, 2) for axis in written.bottom_center_cam)
    return KittiDetails(
        type=written.category,
        truncated=written.truncated,
        occluded=written.occluded,
        alpha=rounded(written.alpha, 2),
        bbox=(x1, y1, x2, y2),
        dimensions=(height, width, length),
        location=(x, y, z),
        rotation_y=rounded(written.rotation_y, 2),
        score=rounded(written.score or 0.0),
    )


def loss_details_of(losses: LossTerms) -> LossDetails:
    """Loss terms, rounded."""
    return LossDetails(
        geometric=rounded(losses.geometric),
        ray_tracing=rounded(losses.ray_tracing),
        center=rounded(losses.center),
        total=rounded(losses.total),
    )


def _probabilities(label: ObjectLabel) -> tuple[float, float] | None:
    if label.iou_probability is None:
        return None
    loose, strict = label.iou_probability
    return rounded(loose), rounded(strict)


def _points(points: PointCounts) -> PointDetails:
    return PointDetails(
        in_prompt=points.in_prompt,
        above_ground=points.above_ground,
        in_cluster=points.in_cluster,
        used=points.used,
    )


def _rejected(hypothesis: Hypothesis) -> RejectedDetails:
    return RejectedDetails(
        reason=hypothesis.reason,
        box=box_details_of(hypothesis.box),
        losses=None if hypothesis.losses is None else loss_details_of(hypothesis.losses),
    )
