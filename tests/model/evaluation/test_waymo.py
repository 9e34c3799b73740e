"""Waymo's average precision on cases that can be computed by hand."""

from __future__ import annotations

import json
from itertools import permutations, product

import numpy as np
import pytest

from boxlift.errors import DatasetError, OptionsError
from boxlift.evaluation import judge_like_waymo, waymo_json, waymo_table
from boxlift.evaluation.optimal_matching import largest_sum, match_at_every_cutoff
from boxlift.evaluation.waymo import WaymoPrecision, average_precision
from boxlift.sweep import SweepLabels
from model.evaluation.sweeps_to_judge import ego_box, sweep, sweeps


def judge(
    truth: list[SweepLabels],
    predictions: list[SweepLabels],
    *,
    level: int = 2,
    part: str = "overall",
    category: str = "Vehicle",
    iou: float = 0.5,
) -> WaymoPrecision:
    entries = judge_like_waymo(truth, predictions, iou).results[category]
    return next(each for each in entries if (each.range, each.level) == (part, f"LEVEL_{level}"))


def test_perfect_predictions_reach_100() -> None:
    entry = judge(sweeps([ego_box()], [ego_box()]), sweeps([ego_box()], [ego_box()]))
    assert (entry.ap_bev, entry.ap_3d, entry.aph_bev, entry.aph_3d) == pytest.approx((100,) * 4)
    assert entry.truths == 2


def test_a_curve_by_hand() -> None:
    # Four truths in four sweeps. Right at .9, wrong at .7, right at .5, one never found, one never found.
    # Cutoffs above .7: precision 1, recall 1/4. From .5 down: precision 2/3, recall 1/2; between: 1/2, 1/4.
    # From recall 1/2 to 1/4 the step is more than .05: level at 2/3 down to .3, then a slope up to 1 at 1/4.
    # From 1/4 to 0: precision 1. Area = .2 * 2/3 + .05 * (2/3 + 1) / 2 + .25 * 1 = .4250.
    truth = sweeps([ego_box()], [ego_box()], [ego_box()], [ego_box()])
    wrong = ego_box(x=20, y=15, score=0.7)
    predictions = sweeps([ego_box(score=0.9)], [wrong], [ego_box(score=0.5)], [])
    assert judge(truth, predictions).ap_3d == pytest.approx(100 * (0.2 * 2 / 3 + 0.05 * 5 / 6 + 0.25))


def test_the_area_under_a_curve() -> None:
    # One point (precision .5, recall 1): the made-up (1, 0) takes its precision, so the area is .5.
    assert average_precision(np.array([0.5]), np.array([1.0])) == pytest.approx(0.5)
    assert average_precision(np.array([1.0]), np.array([0.0])) == 0
    # A better precision at a higher recall lifts the lower: (.5, .02), (.8, .04) -> .8 all the way.
    assert average_precision(np.array([0.5, 0.8]), np.array([0.02, 0.04])) == pytest.approx(0.8 * 0.04)


def test_half_an_overlap_is_enough_and_less_is_not() -> None:
    # 4 m long boxes moved by s overlap (4 - s) / (4 + s): 1/2 at s = 4/3.
    truth = sweeps([ego_box()])
    assert judge(truth, sweeps([ego_box(x=20 + 1.33)])).ap_bev == pytest.approx(100)
    assert judge(truth, sweeps([ego_box(x=20 + 1.34)])).ap_bev == 0
    assert judge(truth, sweeps([ego_box(x=20 + 1.34)]), iou=0.49).ap_bev == pytest.approx(100)
    # 1.5 m high, moved up by .7: (.8) / (2.2) in 3D, all from above.
    lifted = judge(truth, sweeps([ego_box(z=0.7)]))
    assert (lifted.ap_bev, lifted.ap_3d) == pytest.approx((100, 0))


def test_a_turned_heading_costs_aph_only() -> None:
    # Turned by 180 degrees: heading accuracy 0; by 18 degrees: 1 - .1.
    truth = sweeps([ego_box()])
    turned = judge(truth, sweeps([ego_box(yaw_rad=np.pi)]))
    assert (turned.ap_3d, turned.aph_3d) == pytest.approx((100, 0))
    assert judge(truth, sweeps([ego_box(yaw_rad=np.pi / 10)])).aph_bev == pytest.approx(90)
    # 179 and -179 degrees are 2 degrees apart.
    near = judge(sweeps([ego_box(yaw_rad=np.radians(179))]), sweeps([ego_box(yaw_rad=np.radians(-179))]))
    assert near.aph_3d == pytest.approx(100 * (1 - 2 / 180))


def test_levels_by_the_annotator_else_by_points() -> None:
    easy, few, said = ego_box(points=6), ego_box(y=10, points=5), ego_box(y=-10, points=50, difficulty=2)
    truth = sweeps([easy, few, said])
    assert (judge(truth, sweeps([]), level=1).truths, judge(truth, sweeps([])).truths) == (1, 3)
    # At LEVEL_1 only the easy one can be missed, but whatever is found counts: recall 1 with one found.
    assert judge(truth, sweeps([easy]), level=1).ap_3d == pytest.approx(100)
    # At LEVEL_2 recall is 1/3 at precision 1.
    assert judge(truth, sweeps([easy])).ap_3d == pytest.approx(100 / 3)
    # At LEVEL_1 a hard one that is found adds to what there was: 1 found of 1 + 1 missed.
    assert judge(truth, sweeps([few]), level=1).ap_3d == pytest.approx(50)


def test_truths_without_points_are_left_out() -> None:
    evaluation = judge_like_waymo(
        sweeps([ego_box(points=0), ego_box(y=9, points=None)]), sweeps([ego_box(y=9)])
    )
    assert (evaluation.truths_without_points, evaluation.truths_of_unknown_difficulty) == (1, 1)
    assert [each.truths for each in evaluation.results["Vehicle"][:2]] == [1, 1]
    assert "neither a difficulty nor a count" in waymo_table(evaluation)


def test_scores_outside_the_cutoffs_are_told() -> None:
    # Below 0 a prediction counts nowhere; 1.5 is as good as 1.
    evaluation = judge_like_waymo(sweeps([ego_box()]), sweeps([ego_box(score=1.5), ego_box(y=9, score=-0.1)]))
    assert evaluation.results["Vehicle"][1].ap_3d == pytest.approx(100)
    assert evaluation.scores_beyond_cutoffs == 2
    assert "2 predictions have scores outside 0 to 1" in waymo_table(evaluation)


def test_each_side_belongs_to_its_own_range() -> None:
    # The truth is at 29.5 m, the prediction at 30.5 m: overall a hit, in both ranges none.
    truth, predictions = sweeps([ego_box(x=29.5)]), sweeps([ego_box(x=30.5)])
    assert judge(truth, predictions).ap_3d == pytest.approx(100)
    near, far = (judge(truth, predictions, part=part) for part in ("0-30 m", "30-50 m"))
    assert (near.truths, near.ap_3d) == (1, 0)
    assert (far.truths, far.ap_3d) == (0, None)
    # The range is in 3D, and 50 m belongs to the last.
    assert judge(sweeps([ego_box(x=30, y=40)]), sweeps([]), part="50 m-inf").truths == 1
    assert judge(sweeps([ego_box(x=29, z=20)]), sweeps([]), part="30-50 m").truths == 1


def test_scores_of_two_decimals_reach_their_cutoff() -> None:
    # 0.29 in double precision is below 29 * 0.01; in single precision it is the cutoff. At cutoff 0.29 the
    # first is found alone, so that precision is 1 at recall 1/2: with the false one of .285 it would be 1/2.
    truth = sweeps([ego_box(), ego_box(y=10)])
    predictions = sweeps([ego_box(score=0.29), ego_box(y=-20, score=0.285)])
    assert judge(truth, predictions).ap_3d == pytest.approx(50)


def test_the_best_overlap_holds_the_truth_once_it_joins_in() -> None:
    # Turned round and off by a little at .9, exact at .3: from .3 down the exact one holds the truth.
    # Cutoffs in (.3, .9]: precision 1, accuracy 0, recall 1; below: 1 of 2, accuracy 1.
    predictions = sweeps([ego_box(x=20.2, yaw_rad=np.pi, score=0.9), ego_box(score=0.3)])
    entry = judge(sweeps([ego_box()]), predictions)
    assert (entry.ap_3d, entry.aph_3d) == pytest.approx((100, 50))


def test_two_truths_are_shared_out_for_the_largest_sum() -> None:
    # Truths at 0 and 1, predictions at 0.4 and -0.6, 4 m long. IoU (4 - d) / (4 + d): the first overlaps its
    # truths .818 and .739, the second .739 and .429: greedy gives .818 alone, the largest sum .739 + .739.
    truth = sweeps([ego_box(x=20), ego_box(x=21)])
    predictions = sweeps([ego_box(x=20.4, score=0.9), ego_box(x=19.4, score=0.8)])
    assert judge(truth, predictions).ap_bev == pytest.approx(100)


def test_order_of_objects_and_sweeps_does_not_matter() -> None:
    random = np.random.default_rng(0)
    truth = [[ego_box(x=float(x)) for x in random.uniform(5, 60, 6)] for _ in range(5)]
    found = [
        [ego_box(x=each.center_ego[0] + 0.3, score=round(random.random(), 1)) for each in true for _ in "ab"]
        for true in truth
    ]
    reordered = [sweep(*reversed(each), name=str(index)) for index, each in reversed(list(enumerate(found)))]
    first, second = (judge_like_waymo(sweeps(*truth), each) for each in (sweeps(*found), reordered))
    assert first.results == second.results


def test_nothing_and_other_classes() -> None:
    truth = sweeps([ego_box("Car"), ego_box("Tram"), ego_box("pedestrian", y=9)])
    predictions = sweeps([ego_box("TYPE_VEHICLE"), ego_box("Misc", y=5), ego_box("Cyclist", y=5)])
    evaluation = judge_like_waymo(truth, predictions)
    assert evaluation.results["Vehicle"][1].ap_3d == pytest.approx(100)
    assert evaluation.results["Pedestrian"][1].ap_3d == 0
    assert evaluation.results["Cyclist"][1].ap_3d is None
    written = json.loads(json.dumps(waymo_json(evaluation)))
    assert written["truths_of_other_classes"] == {"Tram": 1}
    assert written["predictions_of_other_classes"] == {"Misc": 1}
    assert list(written["results"]) == ["Vehicle", "Pedestrian", "Cyclist", "Sign"]
    assert "Left out truths of other classes: 1 Tram." in waymo_table(evaluation)


def test_sweeps_are_told_by_name() -> None:
    truth = [sweep(ego_box(), name="a"), sweep(ego_box(), name="b")]
    evaluation = judge_like_waymo(truth, [sweep(ego_box(), name="b"), sweep(ego_box(), name="c")])
    assert evaluation.results["Vehicle"][1].ap_3d == pytest.approx(50)
    assert (evaluation.sweeps.without_predictions, evaluation.sweeps.without_truth) == (1, 1)
    logged = [sweep(ego_box(), name="0", log="one"), sweep(ego_box(), name="0", log="two")]
    assert judge(logged, logged).truths == 2


@pytest.mark.parametrize(
    ("truth", "predictions", "problem"),
    [
        ([], [], "no sweep to judge"),
        ([sweep(name="a")], [sweep(name="b")], r"truth \(a, \.\.\.\) has predictions, which are of b"),
        ([sweep(name="a"), sweep(name="a")], [sweep(name="a")], "there twice"),
        ([sweep()], [sweep(ego_box(score=float("nan")))], "not finite"),
        ([sweep(ego_box(x=float("inf")))], [sweep()], "not finite"),
    ],
)
def test_what_cannot_be_judged(
    truth: list[SweepLabels], predictions: list[SweepLabels], problem: str
) -> None:
    with pytest.raises(DatasetError, match=problem):
        judge_like_waymo(truth, predictions)


@pytest.mark.parametrize("iou", [0.0, -1.0, 1.1, float("nan")])
def test_an_iou_that_is_none(iou: float) -> None:
    with pytest.raises(OptionsError):
        judge_like_waymo([sweep()], [sweep()], iou)


def test_the_largest_sum_is_the_largest() -> None:
    random = np.random.default_rng(0)
    for rows, columns in product(range(1, 5), repeat=2):
        weight = random.integers(0, 5, (rows, columns))
        wide = np.pad(weight, ((0, 0), (0, rows)))
        best = max(
            sum(wide[row, column] for row, column in enumerate(each))
            for each in permutations(range(rows + columns), rows)
        )
        taken = largest_sum(weight)
        chosen = taken[taken >= 0]
        assert len(set(chosen.tolist())) == len(chosen)
        assert sum(weight[row, column] for row, column in enumerate(taken) if column >= 0) == best


def test_matching_at_every_cutoff_is_matching_at_each() -> None:
    random = np.random.default_rng(1)
    for _ in range(20):
        table = random.uniform(0.1, 1, (4, 6)) * (random.random((4, 6)) < 0.4)
        score = random.choice([0.1, 0.2, 0.3, 0.4], 6)
        truth, prediction = np.nonzero(table)
        matches = match_at_every_cutoff(truth, prediction, table[truth, prediction], score)
        for cutoff in (0.05, 0.15, 0.2, 0.25, 0.35, 0.45):
            active = score >= cutoff
            weight = np.rint(table[:, active] * 1_000_000).astype(np.int64)
            best = largest_sum(weight)
            expected = sum(weight[row, column] for row, column in enumerate(best) if column >= 0)
            holds = (matches.above < cutoff) & (cutoff <= matches.up_to)
            held = np.rint(table[matches.truth[holds], matches.prediction[holds]] * 1_000_000).sum()
            assert held == expected
            assert len(set(matches.truth[holds].tolist())) == holds.sum()
