from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from boxlift.accurate import probability as module
from boxlift.accurate.parameters import YAW, X
from boxlift.accurate.pipeline import Decision, decide
from boxlift.accurate.probability import FEATURES, features_of, margin, probability
from boxlift.accurate.view import View
from boxlift.accurate.weights import PROBABILITY_WEIGHTS
from boxlift.settings import ACCURATE
from model.small_frame import car, frame_of


@pytest.fixture(scope="module")
def decision() -> Decision:
    return decide(View.of(frame_of([car(3.0, 14.0, -1.4)]), ACCURATE.ground), [0], ACCURATE)[0]


def with_boxes(decision: Decision, *steps: tuple[int, float], energy: list[float]) -> Decision:
    """The chosen box first, then the same moved in one of its numbers each."""
    chosen = decision.parameters[decision.chosen]
    moved = [chosen + size * np.eye(7)[column] for column, size in steps]
    return replace(decision, parameters=np.array([chosen, *moved]), energy=np.array(energy), chosen=0)


def test_every_weight_has_its_feature(decision: Decision) -> None:
    features = features_of(decision)
    assert features.shape == (len(FEATURES),)
    assert np.isfinite(features).all()
    assert features[0] == 1
    assert {len(weights) for weights in PROBABILITY_WEIGHTS.values()} == {len(FEATURES)}


def test_people_are_upright_and_cars_are_not(decision: Decision) -> None:
    last = FEATURES.index("upright")
    assert features_of(decision)[last] == 0
    person = replace(decision.size, lwh_m=np.array([0.6, 0.6, 1.7]))
    assert features_of(replace(decision, size=person))[last] == 1


def test_the_margin_is_over_the_best_box_of_another_place_or_heading(decision: Decision) -> None:
    here, there, turned = (X, 0.5), (X, 1.0), (YAW, 0.5)
    assert margin(with_boxes(decision, here, there, energy=[1.0, 1.5, 4.0])) == 3.0
    assert margin(with_boxes(decision, turned, there, energy=[1.0, 3.0, 4.0])) == 2.0
    assert margin(with_boxes(decision, (YAW, np.pi), there, energy=[1.0, 1.0, 4.0])) == 3.0


def test_the_margin_is_ten_at_most_and_negative_where_a_likelier_place_was_taken(decision: Decision) -> None:
    there = (X, 1.0)
    assert margin(with_boxes(decision, energy=[1.0])) == 10.0
    assert margin(with_boxes(decision, there, energy=[1.0, 99.0])) == 10.0
    assert margin(with_boxes(decision, there, energy=[1.0, np.inf])) == 10.0
    assert margin(with_boxes(decision, there, energy=[1.0, 0.5])) == -0.5


def test_a_probability_is_a_logistic_that_does_not_overflow(
    decision: Decision, monkeypatch: pytest.MonkeyPatch
) -> None:
    values = []
    for weight in (-1e6, -2.0, 0.0, 2.0, 1e6):
        weights = (weight, *(0.0,) * (len(FEATURES) - 1))
        monkeypatch.setattr(module, "PROBABILITY_WEIGHTS", {0.5: weights})
        values.append(probability(decision, 0.5))
    assert values == pytest.approx([0, 1 / (1 + np.e**2), 0.5, 1 / (1 + np.e**-2), 1])


@pytest.mark.parametrize("iou", [0.5, 0.7])
def test_probabilities_are_told_for_two_overlaps(decision: Decision, iou: float) -> None:
    assert 0 <= probability(decision, iou) <= 1
