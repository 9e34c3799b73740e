"""Corrections laid over the machine's labels: the labels of a corrected label set."""

from __future__ import annotations

from collections.abc import Mapping

from boxlift.corrections.correction import Correction, Verdict
from boxlift.formats.details import (
    FrameDetails,
    ObjectDetails,
    ReviewDetails,
    with_reviewed_box,
    without_box,
)


def corrected(details: FrameDetails, corrections: Mapping[int, Correction]) -> FrameDetails:
    """A frame's details with what people said about its objects, by their index.

    Accepted boxes stay and corrected ones are replaced; both are sure then, with a score of 1. Rejected ones
    go. Objects that nobody spoke of, and details themselves, stay as they are.
    """
    objects = tuple(_corrected(item, corrections.get(item.index)) for item in details.objects)
    return details.model_copy(update={"objects": objects})


def _corrected(item: ObjectDetails, correction: Correction | None) -> ObjectDetails:
    if correction is None or correction.opinion.verdict is Verdict.OPEN:
        return item
    opinion = correction.opinion
    review = ReviewDetails(
        verdict=opinion.verdict.value,
        author=correction.author,
        made_at=correction.made_at.isoformat(timespec="seconds"),
    )
    if opinion.verdict is Verdict.REJECTED:
        return without_box(item, review)
    box = opinion.box if opinion.box is not None else item.box
    if box is None:  # accepted that there is none
        return item.model_copy(update={"review": review})
    return with_reviewed_box(item, opinion.category or item.category, box, review)
