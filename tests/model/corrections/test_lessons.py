from __future__ import annotations

import numpy as np
import pytest

from boxlift.corrections.correction import Opinion, Verdict
from boxlift.corrections.lessons import Lesson, lesson_of, recalibrated, shares_by_flag, shares_by_score
from boxlift.errors import OptionsError
from boxlift.formats.details import BoxDetails, ObjectDetails, PointDetails

BOX = BoxDetails(center_cam=(1.0, 1.5, 20.0), length_m=4.0, width_m=1.8, height_m=1.6, rotation_y=0.0)
ITEM = ObjectDetails(
    index=0,
    category="Car",
    prompt_box_px=(0, 0, 10, 10),
    prompt_score=1.0,
    result="FITTED",
    sentence="",
    score=0.8,
    flags=("few_points",),
    box=BOX,
    kitti=None,
    losses=None,
    points=PointDetails(in_prompt=9, above_ground=9, in_cluster=9, used=9),
    rejected=(),
)


def corrected(x: float, category: str = "Car") -> Opinion:
    box = BOX.model_copy(update={"center_cam": (x, 1.5, 20.0)})
    return Opinion(verdict=Verdict.CORRECTED, box=box, category=category)


@pytest.mark.parametrize(
    ("opinion", "right"),
    [
        (Opinion(verdict=Verdict.ACCEPTED), True),
        (Opinion(verdict=Verdict.REJECTED), False),
        (corrected(1.2), True),  # moved by 20 cm along its 4 m
        (corrected(3.0), False),  # by half its length: an IoU of a third
        (corrected(1.0, "Van"), False),
    ],
)
def test_a_box_is_right_where_the_right_one_is_near(opinion: Opinion, right: bool) -> None:
    assert lesson_of(ITEM, opinion) == Lesson(0.8, ("few_points",), right)


def test_nothing_is_learned_where_nothing_was_said_or_boxed() -> None:
    assert lesson_of(ITEM, Opinion(verdict=Verdict.OPEN)) is None
    assert lesson_of(ITEM.model_copy(update={"box": None}), Opinion(verdict=Verdict.REJECTED)) is None


def test_shares() -> None:
    lessons = [Lesson(0.9, ("truncated",), True), Lesson(0.95, ("truncated",), False), Lesson(0.2, (), True)]
    flagged, bare = shares_by_flag(lessons)
    assert (flagged.name, flagged.boxes, flagged.right, bare.name) == ("truncated", 2, 1, "no flag")
    assert [(each.name, each.boxes, each.right) for each in shares_by_score(lessons)] == [
        ("score .2", 1, 1),
        ("score .9", 2, 1),
    ]


def test_scores_that_promise_too_much_come_down_in_order() -> None:
    """Drawn from a world in which the logit is half of what the score says, less .5."""
    rng = np.random.default_rng(0)
    scores = rng.uniform(0.05, 0.99, 3000)
    logits = np.log(scores / (1 - scores))
    right = rng.uniform(size=3000) < 1 / (1 + np.exp(-(0.5 * logits - 0.5)))
    lessons = [Lesson(float(score), (), bool(was)) for score, was in zip(scores, right, strict=True)]
    found = recalibrated(lessons)
    assert (found.slope, found.offset) == pytest.approx((0.5, -0.5), abs=0.15)
    assert 0 < found(0.0) < found(0.5) < found(0.9) < found(1.0) < 1


def test_sure_boxes_of_which_half_are_wrong_are_sure_no_more() -> None:
    """Their logits are so large that whole steps of Newton's would run away."""
    scores = [0.25, 0.5, 0.8] + [0.99] * 10 + [0.998] * 12
    found = recalibrated([Lesson(score, (), at % 2 == 0) for at, score in enumerate(scores)])
    assert found(0.998) == pytest.approx(0.5, abs=0.1)


def test_few_verdicts_move_little_and_honest_scores_stay() -> None:
    lessons = [Lesson(0.7, (), at % 10 < 7) for at in range(20)]
    assert recalibrated(lessons)(0.7) == pytest.approx(0.7, abs=0.02)


@pytest.mark.parametrize("lessons", [[], [Lesson(0.7, (), True)] * 40, [Lesson(0.7, (), False)] * 40])
def test_nothing_can_be_learned_from_one_kind(lessons: list[Lesson]) -> None:
    with pytest.raises(OptionsError, match="rescore"):
        recalibrated(lessons)
