from __future__ import annotations

import pytest

from boxlift.formats.details import BoxDetails, FrameDetails, ObjectDetails, PointDetails
from boxlift.formats.kitti_label import KittiObject
from boxlift_client.report.contents import Contents, timing_of
from boxlift_client.report.judgement import (
    JudgedObject,
    judge_frame,
    recall_by_points,
    reliability,
    worst,
)

PROMPT = (100.0, 100.0, 200.0, 160.0)


def found(
    x: float, score: float, prompt: tuple[float, float, float, float] = PROMPT, index: int = 0
) -> ObjectDetails:
    """A car at (x, 1, 20)."""
    box = BoxDetails(center_cam=(x, 1.0, 20.0), length_m=4.0, width_m=1.8, height_m=1.6, rotation_y=0.0)
    return ObjectDetails(
        index=index,
        category="Car",
        prompt_box_px=prompt,
        prompt_score=1.0,
        result="FITTED",
        sentence="A box was fitted.",
        score=score,
        iou_probability=(score, 0.1),
        flags=(),
        box=box,
        kitti=None,
        losses=None,
        points=PointDetails(in_prompt=50, above_ground=40, in_cluster=40, used=40),
        rejected=(),
    )


def true(x: float, category: str = "Car", box_px: tuple[float, float, float, float] = PROMPT) -> KittiObject:
    """The truth of a car at (x, 1, 20); KITTI has the bottom's centre."""
    has_box = category != "DontCare"
    size = (1.6, 1.8, 4.0) if has_box else (-1.0, -1.0, -1.0)
    place = (x, 1.8, 20.0) if has_box else (-1000.0, -1000.0, -1000.0)
    return KittiObject(category, 0.0, 0, 0.0, box_px, size, place, 0.0)


def test_a_box_is_judged_by_the_truth_of_its_prompt() -> None:
    elsewhere = (400.0, 100.0, 500.0, 160.0)
    details = FrameDetails(frame="f", objects=(found(0.0, 0.9), found(9.0, 0.8, elsewhere, 1)))
    judged, suspects = judge_frame(details, [true(1.0), true(0.0, "Van"), true(9.0, box_px=elsewhere)])
    # Moved by one of its four metres: three are shared, and five covered.
    assert [each.iou for each in judged] == pytest.approx([3 / 5, 1.0])
    assert suspects == []


def test_a_sure_box_without_a_truth_is_a_suspect_unless_nobody_labelled_there() -> None:
    details = FrameDetails(frame="f", objects=(found(0.0, 0.9),))
    _, suspects = judge_frame(details, [true(30.0, box_px=(600.0, 100.0, 700.0, 160.0))])
    assert [(each.frame, each.score) for each in suspects] == [("f", 0.9)]
    assert judge_frame(details, [true(0.0, "DontCare", (90.0, 90.0, 220.0, 170.0))])[1] == []
    assert judge_frame(details, [true(1.0)])[1] == []
    unsure = FrameDetails(frame="f", objects=(found(0.0, 0.5),))
    assert judge_frame(unsure, [])[1] == []
    assert len(judge_frame(details, [])[1]) == 1


def judged(probability: float, iou: float, points: int = 50, has_box: bool = True) -> JudgedObject:
    return JudgedObject("f", 0, "Car", probability, points, has_box, iou)


def test_reliability_is_how_often_a_probability_came_true() -> None:
    bins = reliability([judged(0.92, 0.8), judged(0.98, 0.3), judged(0.15, 0.1), judged(0.5, 0, 5, False)])
    assert [(each.predicted, each.right, each.boxes) for each in bins] == [(0.15, 0.0, 1), (0.95, 0.5, 2)]


def test_recall_counts_truths_without_a_box() -> None:
    rows = recall_by_points(
        [judged(0.9, 0.8), judged(0.9, 0.6), judged(0.0, 0.0, 50, False), judged(1, 1, 5)]
    )
    assert [(row.points, row.truths) for row in rows] == [("0-9", 1), ("30-99", 3)]
    assert (rows[1].recall_loose, rows[1].recall_strict) == pytest.approx((2 / 3, 1 / 3))


def test_the_worst_are_boxes_with_the_least_overlap_the_surest_first() -> None:
    low, sure, good = judged(0.2, 0.0), judged(0.9, 0.0), judged(0.9, 0.9)
    assert worst([good, low, sure, judged(1.0, 0.0, has_box=False)], 2) == [sure, low]


def test_contents_are_counted() -> None:
    contents = Contents(kept_frames=1)
    contents.add(FrameDetails(frame="sure", objects=(found(0.0, 0.99),)))
    contents.add(FrameDetails(frame="unsure", objects=(found(0.0, 0.5), found(1.0, 1.0, index=1))))
    assert (contents.frames, contents.objects, contents.boxes) == (2, 3, 3)
    assert (contents.scores[5], contents.scores[9]) == (1, 2)
    assert contents.depths == {2: 3}
    assert contents.frames_worth_a_look() == ["unsure"]
    (row,) = contents.sizes()
    assert row.length_m == (4.0, 4.0, 4.0)


def test_timing() -> None:
    timing = timing_of([("a", 1.0), ("b", 3.0), ("c", 2.0)])
    assert timing is not None
    assert (timing.median_s, timing.longest_s, timing.longest) == (2.0, 3.0, "b")
    assert timing_of([]) is None
