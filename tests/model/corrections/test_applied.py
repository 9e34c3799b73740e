from __future__ import annotations

from datetime import UTC, datetime

import pytest

from boxlift.corrections.applied import corrected
from boxlift.corrections.correction import Correction, Opinion, Verdict
from boxlift.corrections.worth import worth_a_look
from boxlift.formats.details import BoxDetails, FrameDetails, details_of, kitti_text
from boxlift.labeller import Labeller
from model.small_frame import car, frame_of

BOX = BoxDetails(center_cam=(1.0, 1.5, 20.0), length_m=4.5, width_m=1.9, height_m=1.7, rotation_y=0.3)


@pytest.fixture(scope="module")
def details() -> FrameDetails:
    return details_of(Labeller().label(frame_of([car(2.0, 18.0, 0.4)])))


def said(opinion: Opinion) -> dict[int, Correction]:
    made_at = datetime(2026, 11, 27, 12, 0, tzinfo=UTC)
    made = Correction(
        sequence=1,
        frame="f",
        object_index=0,
        revision=1,
        opinion=opinion,
        author="ann",
        made_at=made_at,
        request_id="request-1",
    )
    return {0: made}


def test_a_corrected_box_replaces_the_machines_which_stays_to_be_seen(details: FrameDetails) -> None:
    before = details.objects[0]
    item = corrected(details, said(Opinion(verdict=Verdict.CORRECTED, box=BOX, category="Van"))).objects[0]
    assert (item.box, item.category, item.score, item.result) == (BOX, "Van", 1.0, "CORRECTED")
    assert item.rejected[0].box == before.box
    assert item.review is not None
    assert (item.review.author, item.review.made_at) == ("ann", "2026-11-27T12:00:00+00:00")
    assert item.kitti is not None
    # KITTI has the centre of the bottom face.
    assert item.kitti.location == pytest.approx((1.0, 1.5 + 1.7 / 2, 20.0))
    assert item.kitti.bbox == before.prompt_box_px


def test_an_accepted_box_stays_and_is_sure(details: FrameDetails) -> None:
    item = corrected(details, said(Opinion(verdict=Verdict.ACCEPTED))).objects[0]
    before = details.objects[0]
    assert (item.box, item.result, item.losses) == (before.box, before.result, before.losses)
    assert item.score == 1.0
    assert item.kitti is not None
    assert item.kitti.score == 1.0


def test_a_rejected_box_goes(details: FrameDetails) -> None:
    after = corrected(details, said(Opinion(verdict=Verdict.REJECTED)))
    assert (after.objects[0].box, after.objects[0].score) == (None, 0.0)
    assert kitti_text(after) == ""
    assert after.objects[0].rejected[0].box == details.objects[0].box


@pytest.mark.parametrize("corrections", [{}, said(Opinion(verdict=Verdict.OPEN))])
def test_what_nobody_speaks_of_stays(details: FrameDetails, corrections: dict[int, Correction]) -> None:
    assert corrected(details, corrections) == details


def test_a_box_that_may_be_right_or_wrong_is_worth_most(details: FrameDetails) -> None:
    (item,) = details.objects

    def worth(right: float, *flags: str) -> float:
        changes = {"score": right, "flags": flags}
        return worth_a_look(item.model_copy(update=changes))

    assert worth(0.5) == pytest.approx(1.0)
    assert worth(0.5) > worth(0.7) > worth(0.95)
    assert worth(0.5) > worth(0.2) > worth(0.02)
    assert worth(0.7, "truncated") > worth(0.7)
    assert worth(0.7, "heading_ambiguous") == worth(0.7)
    without = item.model_copy(update={"box": None, "prompt_score": 0.8})
    assert worth_a_look(without) == pytest.approx(0.4)
