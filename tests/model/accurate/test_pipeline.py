from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from boxlift import Boxes3D, Frame, Prompt
from boxlift.accurate.parameters import HEIGHT, LENGTH, X, Z, to_boxes
from boxlift.accurate.pipeline import Decision, _exclude, decide, size_pull
from boxlift.accurate.view import View
from boxlift.overlap import bev_intersection, bev_iou, iou_3d
from boxlift.priors import SIZE_PRIORS, SizePrior
from boxlift.settings import ACCURATE, LabellerSettings
from boxlift.stage_times import StageTimes
from model.small_frame import car, frame_of

CARS = [car(3.0, 14.0, -1.4), car(-5.0, 22.0, -1.7), car(6.0, 30.0, 0.0)]


def decided(frame: Frame, settings: LabellerSettings = ACCURATE) -> dict[int, Decision]:
    return decide(View.of(frame, settings.ground), range(len(frame.prompts)), settings)


def repaired(**options: object) -> LabellerSettings:
    return ACCURATE.with_options({"repairs": options})


def box_of(decision: Decision) -> Boxes3D:
    return to_boxes(decision.parameters[[decision.chosen]])


def overlap_m2(decisions: Sequence[Decision]) -> float:
    first, second = (box_of(decision) for decision in decisions)
    return float(bev_intersection(first, second)[0])


def test_finds_cars_of_another_size_than_the_typical_one() -> None:
    """The cars are 1.6 m tall and 1.8 m wide; the typical one has 1.49 and 1.69."""
    decisions = decided(frame_of(CARS))
    for index, truth in enumerate(CARS):
        assert iou_3d(box_of(decisions[index]), truth)[0] > 0.8


def test_what_a_decision_holds_is_of_one_length_and_the_chosen_is_the_likeliest() -> None:
    for decision in decided(frame_of(CARS)).values():
        count = len(decision.parameters)
        assert 2 <= count <= 6
        assert decision.energy.shape == (count,)
        assert decision.evidence.matrix().shape[0] == count
        assert len(decision.losses) == len(decision.used) == count
        assert decision.energy[decision.chosen] == decision.energy.min()
        for losses, used in zip(decision.losses, decision.used, strict=True):
            assert (losses is None) == (used < 3)


def test_only_usable_prompts_are_decided_on() -> None:
    frame = frame_of(CARS)
    view = View.of(frame, ACCURATE.ground)
    assert list(decide(view, [1], ACCURATE)) == [1]
    assert decide(view, [], ACCURATE) == {}


def test_a_prompt_with_ground_only_has_no_decision() -> None:
    road = Prompt("Car", (500.0, 300.0, 600.0, 360.0))
    frame = frame_of(CARS[:1], [road, *frame_of(CARS[:1]).prompts])
    assert list(decided(frame)) == [1]


def test_times_name_the_stages() -> None:
    times = StageTimes()
    frame = frame_of(CARS[:1])
    decide(View.of(frame, ACCURATE.ground), [0], ACCURATE, times)
    assert list(times.seconds) == ["scout", "fit", "polish", "evidence"]


def test_a_decision_does_not_depend_on_prompts_with_points_of_their_own() -> None:
    """Nor on the size of the batch; prompts keep their numbers, which seed the samples."""
    frame = frame_of([*CARS[:2], car(14.0, 30.0, 0.0)])
    view = View.of(frame, ACCURATE.ground)
    together = decide(view, [0, 1, 2], ACCURATE)
    for index in range(3):
        alone = decide(view, [index], ACCURATE)[index]
        assert alone.parameters == pytest.approx(together[index].parameters, abs=1e-6)
        assert alone.chosen == together[index].chosen


def test_the_order_of_prompts_is_not_that_of_the_list() -> None:
    """Near to far: claims are the same whichever stands first. Few points, so that none is sampled."""
    frame = few_points(frame_of(CARS))
    turned = replace(frame, prompts=frame.prompts[::-1])
    decisions, backwards = decided(frame), decided(turned)
    for index in range(3):
        assert len(decisions[index].region.inside) < 160
        assert backwards[2 - index].parameters == pytest.approx(decisions[index].parameters, abs=1e-6)


def few_points(frame: Frame) -> Frame:
    """The ground, and a third of the points on each car."""
    points = frame.points_velo
    return replace(frame, points_velo=np.concatenate([points[:6000], points[6000::3]]))


def test_a_car_behind_another_gets_its_own_points() -> None:
    """Its prompt is half covered by a nearer car, which has most of the points there."""
    front, back = car(0.0, 12.0, -1.5), car(1.6, 19.0, -1.55)
    decisions = decided(frame_of([front, back]))
    assert iou_3d(box_of(decisions[0]), front)[0] > 0.7
    assert iou_3d(box_of(decisions[1]), back)[0] > 0.6
    assert decisions[1].region.may_hide
    view = View.of(frame_of([front, back]), ACCURATE.ground)
    depth_m = view.points_cam[decisions[1].region.inside][:, 2]
    assert np.mean(depth_m > 15) > 0.9
    unclaimed = decided(frame_of([front, back]), repaired(claim=False))
    depth_m = view.points_cam[unclaimed[1].region.inside][:, 2]
    assert np.mean(depth_m > 15) < 0.8


def test_two_prompts_of_one_car_do_not_both_get_its_place() -> None:
    """Nothing is claimed here, so that both see the same points: only the exclusion parts them."""
    prompt = frame_of(CARS[:1]).prompts[0]
    x1, y1, x2, y2 = prompt.box_px
    frame = frame_of(CARS[:1], [prompt, replace(prompt, box_px=(x1 - 3, y1, x2, y2 - 2))])
    together = decided(frame, repaired(claim=False, exclusion_weight=0.0))
    apart = decided(frame, repaired(claim=False, exclusion_weight=1000.0))
    assert bev_iou(box_of(together[0]), box_of(together[1]))[0] > 0.8
    assert overlap_m2(list(apart.values())) < 0.3 * overlap_m2(list(together.values()))


@pytest.mark.parametrize(("weight", "chosen"), [(10.0, [1, 0]), (0.5, [0, 0])])
def test_who_has_a_good_place_elsewhere_goes_there_when_it_is_worth_it(
    weight: float, chosen: list[int]
) -> None:
    """Two boxes in one place; the second one's other place is 5 worse, the first one's only 1."""
    one = decided(frame_of(CARS[:1]))[0]
    here = one.parameters[one.chosen]
    decisions = [
        replace(one, parameters=np.array([here, here + shift * np.eye(7)[X]]), energy=energy, chosen=0)
        for shift, energy in ((6.0, np.array([0.0, 1.0])), (-6.0, np.array([0.0, 5.0])))
    ]
    assert [decision.chosen for decision in _exclude(decisions, weight)] == chosen


def test_a_second_prompt_on_a_claimed_car_has_nothing_left() -> None:
    prompt = frame_of(CARS[:1]).prompts[0]
    decisions = decided(frame_of(CARS[:1], [prompt, prompt]))
    leftover = {index: len(decision.region.inside) for index, decision in decisions.items()}
    assert leftover[0] > 100
    assert leftover.get(1, 0) < 0.2 * leftover[0]


def test_without_polish_the_boxes_keep_the_size_they_started_from() -> None:
    typical = size_pull(SIZE_PRIORS["Car"]).lwh_m
    for decision in decided(frame_of(CARS), repaired(polish=False)).values():
        assert decision.parameters[:, LENGTH : HEIGHT + 1].tolist() == [typical.tolist()] * len(
            decision.parameters
        )
    polished = decided(frame_of(CARS))[0]
    assert polished.parameters[polished.chosen, HEIGHT] > typical[2] + 0.03


def test_choosing_by_loss_takes_the_lowest_loss() -> None:
    for decision in decided(frame_of(CARS), repaired(choose="loss", exclusion_weight=0.0)).values():
        totals = [np.inf if losses is None else losses.total for losses in decision.losses]
        assert decision.chosen == int(np.argmin(totals))


@pytest.mark.parametrize("fits", [1, 3])
def test_no_more_hypotheses_than_asked_for(fits: int) -> None:
    for decision in decided(frame_of(CARS), repaired(fits=fits)).values():
        assert len(decision.parameters) <= fits


def test_the_boxes_stand_near_their_start_on_the_ground() -> None:
    decision = decided(frame_of(CARS[:1]))[0]
    x, z = decision.parameters[decision.chosen, [X, Z]]
    assert (x, z) == pytest.approx((3.0, 14.0), abs=0.25)
    assert to_boxes(decision.parameters).bottom_y == pytest.approx(1.65, abs=0.15)


def test_sizes_are_pulled_to_the_typical_one_or_to_the_frozen_one() -> None:
    typical = SIZE_PRIORS["Car"].templates[0]
    pull = size_pull(SIZE_PRIORS["Car"])
    assert pull.lwh_m.tolist() == [typical.length_m, typical.width_m, typical.height_m]
    own = SizePrior(height_m=2.0, width_m=1.0, length_m=3.0, source="Measured.", spread=(0.1, 0.2, 0.3))
    pull = size_pull(own)
    assert pull.lwh_m.tolist() == [3.0, 1.0, 2.0]
    assert pull.sigma_m.tolist() == pytest.approx([0.3, 0.2, 0.6])
