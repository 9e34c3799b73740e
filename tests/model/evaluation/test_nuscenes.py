"""nuScenes' average precision and errors on cases that can be computed by hand."""

from __future__ import annotations

import json
from functools import partial

import numpy as np
import pytest

from boxlift.errors import DatasetError
from boxlift.evaluation import judge_like_nuscenes, nuscenes_json, nuscenes_table
from boxlift.evaluation.nuscenes import NuscenesPrecision
from boxlift.sweep import SweepLabels
from model.evaluation.sweeps_to_judge import ego_box, sweep, sweeps

car = partial(ego_box, "car")


def judge(truth: list[SweepLabels], predictions: list[SweepLabels], name: str = "car") -> NuscenesPrecision:
    return judge_like_nuscenes(truth, predictions).results[name]


def test_perfect_predictions() -> None:
    entry = judge(sweeps([car(), car(y=9)]), sweeps([car(score=0.9), car(y=9, score=0.8)]))
    assert entry.ap == pytest.approx(100)
    assert (entry.errors.ate, entry.errors.ase, entry.errors.aoe) == pytest.approx((0, 0, 0))
    assert entry.errors.aae is None


def test_distances_by_hand() -> None:
    # 0.8 m off: wrong at 0.5 m, right at 1, 2 and 4 m.
    entry = judge(sweeps([car()]), sweeps([car(x=20.8)]))
    assert entry.ap_at_m == pytest.approx({"0.5": 0, "1": 100, "2": 100, "4": 100})
    assert entry.ap == pytest.approx(75)
    assert entry.errors.ate == pytest.approx(0.8)
    # Height does not matter, and a distance of exactly 2 m is too far.
    assert judge(sweeps([car()]), sweeps([car(x=22, z=9)])).ap_at_m["2"] == 0


def test_a_curve_by_hand() -> None:
    # Two truths; by score right, wrong, right: precision 1, 1/2, 2/3 at recall 1/2, 1/2, 1.
    # Interpolated: 1 up to recall .49 (39 of the 90 recalls .11, ..., 1 lie below .5), at .5 the last of the
    # equal recalls, 1/2, then a line from 1/2 to 2/3 over 50 steps. (p - .1) / .9 is averaged.
    truth = sweeps([car(), car(y=9)])
    predictions = sweeps([car(score=0.9), car(y=-9, score=0.8), car(y=9, score=0.7)])
    line = np.linspace(1 / 2, 2 / 3, 51)
    expected = (39 * 1.0 + ((line - 0.1) / 0.9).sum()) / 90
    assert judge(truth, predictions).ap_at_m["2"] == pytest.approx(100 * expected)


def test_a_recall_of_a_tenth_earns_nothing() -> None:
    # One of ten found: recall 0.1, no recall above; the errors are 1.
    truth = sweeps(*([car()] for _ in range(10)))
    entry = judge(truth, sweeps([car()], *([] for _ in range(9))))
    assert entry.ap == 0
    assert (entry.errors.ate, entry.errors.aoe) == (1, 1)
    # One of nine: recall 1/9 covers .11 only, of 90 recalls, at precision 1.
    assert judge(truth[:9], sweeps([car()])).ap == pytest.approx(100 / 90)


def test_errors_by_hand() -> None:
    # 5 m long instead of 4: the volumes share 4/5. 30 degrees off.
    entry = judge(sweeps([car()]), sweeps([car(length_m=5.0, yaw_rad=np.pi / 6)]))
    assert (entry.errors.ase, entry.errors.aoe) == pytest.approx((1 / 5, np.pi / 6))
    # The running mean of 0.2 and 0.6 is 0.2 and 0.4; scores .9 at recalls up to .5, then down to .1: the mean
    # error falls to 0.2 where the score is .9 and lies on the line to 0.4 between.
    truth = sweeps([car(), car(y=9)])
    entry = judge(truth, sweeps([car(x=20.2, score=0.9), car(x=20.6, y=9, score=0.1)]))
    expected = (40 * 0.2 + np.linspace(0.2, 0.4, 51)[1:].sum()) / 90
    assert entry.errors.ate == pytest.approx(expected)


def test_the_better_one_takes_the_nearest_free_truth() -> None:
    # The second is nearest to the taken truth, and the next is within 2 m but not within 1.
    truth = sweeps([car(x=20), car(x=22)])
    entry = judge(truth, sweeps([car(x=20, score=0.9), car(x=20.3, score=0.8)]))
    assert entry.ap_at_m["2"] == pytest.approx(100)
    assert entry.ap_at_m["1"] == pytest.approx(100 * (39 + 4 / 9) / 90)  # as above, 1/2 at recall 1/2


def test_of_equal_scores_the_last_comes_first() -> None:
    # As the devkit sorts: the last of equal scores takes the truth.
    truth = sweeps([car()])
    first = judge(truth, sweeps([car(x=20.5), car(x=21)]))
    second = judge(truth, sweeps([car(x=21), car(x=20.5)]))
    assert (first.errors.ate, second.errors.ate) == pytest.approx((1.0, 0.5))


def test_class_ranges_and_points() -> None:
    truth = sweeps(
        [car(x=49.9), car(x=50), car(points=0), ego_box("pedestrian", x=40), ego_box("barrier", 29)]
    )
    evaluation = judge_like_nuscenes(truth, sweeps([]))
    assert {name: each.truths for name, each in evaluation.results.items() if each.truths} == {
        "car": 1,
        "barrier": 1,
    }
    # A prediction beyond the range is neither right nor wrong.
    assert judge(sweeps([car()]), sweeps([car(score=0.5), car(x=51, score=0.9)])).ap == pytest.approx(100)


def test_barriers_are_alike_from_behind_and_cones_have_no_heading() -> None:
    for name, error in (("barrier", 0.0), ("car", np.pi), ("traffic_cone", None)):
        truth, found = sweeps([ego_box(name)]), sweeps([ego_box(name, yaw_rad=np.pi)])
        assert judge(truth, found, name).errors.aoe == (
            None if error is None else pytest.approx(error, abs=1e-9)
        )


def test_bicycles_in_a_rack_are_left_out() -> None:
    rack = ego_box("static_object.bicycle_rack", yaw_rad=np.pi / 2, length_m=6.0)
    # The rack reaches 3 m to the sides and 1 m ahead.
    truth = sweeps([rack, *(ego_box("bicycle", x, y) for x, y in ((20, 2.9), (22.9, 0)))])
    entry = judge(truth, sweeps([ego_box("bicycle", 20, -2), ego_box("bicycle", 22.9, 0)]), "bicycle")
    assert (entry.truths, entry.ap) == pytest.approx((1, 100))


def test_attributes() -> None:
    parked, moving = "vehicle.parked", "vehicle.moving"
    truth = sweeps([car(attribute=parked)], [car(attribute=parked)], [car()])
    predictions = sweeps(
        [car(attribute=parked, score=0.9)],
        [car(attribute=moving, score=0.5)],
        [car(attribute=moving, score=0.1)],
    )
    # Right, wrong, not known: running means 0, 1/2, 1/2 at the recalls 1/3, 2/3, 1, with lines between.
    between = np.arange(34, 67) / 100
    expected = ((between - 1 / 3) * 3 / 2).sum() + 34 / 2
    assert judge(truth, predictions).errors.aae == pytest.approx(expected / 90)
    cones = sweeps([ego_box("traffic_cone", attribute="x")])
    assert judge(cones, cones, "traffic_cone").errors.aae is None


def test_means_and_what_is_not_known() -> None:
    evaluation = judge_like_nuscenes(
        sweeps([car(), ego_box("pedestrian", y=9)]), sweeps([car(), ego_box("Tram", y=9)])
    )
    assert (evaluation.means.classes, evaluation.means.ap) == pytest.approx((2, 50))
    assert (evaluation.means_of_ten.classes, evaluation.means_of_ten.ap) == pytest.approx((10, 10))
    assert evaluation.means.errors.ate == pytest.approx(0.5)
    assert evaluation.means_of_ten.errors.aoe == pytest.approx(8 / 9)  # nine classes have a heading
    written = json.loads(json.dumps(nuscenes_json(evaluation)))
    assert written["nds"] is None
    assert written["results"]["car"]["errors"]["ave"] is None
    assert written["predictions_of_other_classes"] == {"Tram": 1}
    table = nuscenes_table(evaluation)
    assert "no nuScenes detection score" in table
    assert "mean of 10" in table


def test_nothing_at_all() -> None:
    evaluation = judge_like_nuscenes([sweep()], [sweep()])
    assert evaluation.means.ap is None
    assert evaluation.results["car"].ap is None
    assert "mean of 0" in nuscenes_table(evaluation)


def test_too_many_predictions_and_boxes_without_size() -> None:
    with pytest.raises(DatasetError, match="501 predictions"):
        judge_like_nuscenes([sweep()], [sweep(*[car()] * 501)])
    with pytest.raises(DatasetError, match="without size"):
        judge_like_nuscenes([sweep()], [sweep(car(length_m=0.0))])
