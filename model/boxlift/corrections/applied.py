"""Corrections laid over the machine's labels: the labels of a corrected label set."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from boxlift.corrections.correction import Correction, Verdict
from boxlift.formats.changed_details import with_reviewed_box, with_score, without_box
from boxlift.formats.details import FrameDetails, ObjectDetails, ReviewDetails


def corrected(
    details: FrameDetails,
    corrections: Mapping[int, Correction],
    rescore: Callable[[float], float] | None = None,
) -> FrameDetails:
    """A frame's details with what people said about its objects, by their index.

    Accepted boxes stay and corrected ones are replaced; both are sure then, with a score of 1. Rejected ones
    go. Objects that nobody spoke of, and details themselves, stay as they are, but for their score where
    there is a `rescore`.
    """
    objects = tuple(_corrected(item, corrections.get(item.index), rescore) for item in details.objects)
    return details.model_copy(update={"objects": objects})


def _corrected(
    item: ObjectDetails, correction: Correction | None, rescore: Callable[[float], float] | None
) -> ObjectDetails:
    if correction is None or correction.opinion.verdict is Verdict.OPEN:
        return item if rescore is None or item.box is None else with_score(item, rescore(item.score))
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
