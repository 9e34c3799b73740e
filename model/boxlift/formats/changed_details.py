"""Details of an object as others change them: its track, or a reviewer."""

from __future__ import annotations

from boxlift.boxes import Boxes3D
from boxlift.formats import kitti_label
from boxlift.formats.details import (
    BoxDetails,
    ObjectDetails,
    PointDetails,
    RejectedDetails,
    ReviewDetails,
    TrackDetails,
    box_details_of,
    boxes3d_of_details,
    kitti_details_of,
    loss_details_of,
    rounded,
)
from boxlift.frame import LossTerms, Result


def with_box(
    item: ObjectDetails,
    category: str,
    box: Boxes3D,
    score: float,
    flags: tuple[str, ...],
    track: TrackDetails,
    result: Result,
    losses: LossTerms | None,
) -> ObjectDetails:
    """An object with the class, the box and the losses of its track, and its own box as a rejected one."""
    rejected = item.rejected
    if item.box is not None:
        own = RejectedDetails(reason="What this frame alone says.", box=item.box, losses=item.losses)
        rejected = (own, *rejected)
    written = kitti_label.from_box3d(category, item.prompt_box_px, box, score)
    changes: dict[str, object] = {
        "category": category,
        "result": result.name,
        "sentence": result.value,
        "score": rounded(score),
        "iou_probability": None,
        "flags": flags,
        "box": box_details_of(box),
        "kitti": kitti_details_of(written),
        "losses": None if losses is None else loss_details_of(losses),
        "rejected": rejected,
        "track": track,
    }
    return item.model_copy(update=changes)


def with_own_box(
    item: ObjectDetails, score: float, flags: tuple[str, ...], track: TrackDetails
) -> ObjectDetails:
    """An object with its own box, as its track has it."""
    kitti = None if item.kitti is None else item.kitti.model_copy(update={"score": rounded(score)})
    changes = {"score": rounded(score), "flags": flags, "kitti": kitti, "track": track}
    return item.model_copy(update=changes)


def with_reviewed_box(
    item: ObjectDetails, category: str, box: BoxDetails, review: ReviewDetails
) -> ObjectDetails:
    """An object with the box that a reviewer vouches for; the machine's, where another, as a rejected one."""
    written = kitti_label.from_box3d(category, item.prompt_box_px, boxes3d_of_details([box]), score=1.0)
    changes: dict[str, object] = {"score": 1.0, "kitti": kitti_details_of(written), "review": review}
    if (box, category) != (item.box, item.category):
        rejected = item.rejected
        if item.box is not None:
            machine = RejectedDetails(reason="What the machine said.", box=item.box, losses=item.losses)
            rejected = (machine, *rejected)
        result = Result.CORRECTED
        changes |= {
            "category": category,
            "result": result.name,
            "sentence": result.value,
            "iou_probability": None,
            "box": box,
            "losses": None,
            "rejected": rejected,
        }
    return item.model_copy(update=changes)


def with_score(item: ObjectDetails, score: float) -> ObjectDetails:
    """An object whose box is trusted otherwise."""
    kitti = None if item.kitti is None else item.kitti.model_copy(update={"score": rounded(score)})
    return item.model_copy(update={"score": rounded(score), "kitti": kitti})


def without_box(item: ObjectDetails, review: ReviewDetails) -> ObjectDetails:
    """An object whose box a reviewer rejected."""
    rejected = item.rejected
    if item.box is not None:
        rejected = (RejectedDetails(reason="A reviewer.", box=item.box, losses=item.losses), *rejected)
    result = Result.REJECTED
    changes: dict[str, object] = {
        "result": result.name,
        "sentence": result.value,
        "score": 0.0,
        "iou_probability": None,
        "box": None,
        "kitti": None,
        "losses": None,
        "rejected": rejected,
        "review": review,
    }
    return item.model_copy(update=changes)


def object_without_prompt(
    index: int, category: str, outline_px: tuple[float, float, float, float], points: PointDetails
) -> ObjectDetails:
    """What stands in for a prompt where there was none: the outline of a box that other frames gave."""
    x1, y1, x2, y2 = (rounded(edge, 2) for edge in outline_px)
    return ObjectDetails(
        index=index,
        category=category,
        prompt_box_px=(x1, y1, x2, y2),
        prompt_score=0.0,
        result=Result.FILLED.name,
        sentence=Result.FILLED.value,
        score=0.0,
        flags=(),
        box=None,
        kitti=None,
        losses=None,
        points=points,
        rejected=(),
    )
