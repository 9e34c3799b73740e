"""From evidence to a calibrated probability that the 3D IoU with the truth exceeds .5, and .7.

Logistic regression on the evidence of the chosen box: see benchmarks/calibration.py for the data that it
was fitted to, and for the reliability on drives that had no part in it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from boxlift.accurate.parameters import YAW, X, Z
from boxlift.accurate.weights import PROBABILITY_WEIGHTS
from boxlift.camera import Floats

if TYPE_CHECKING:
    from boxlift.accurate.pipeline import Decision

FEATURES = (
    "one",
    "sides",
    "vertical",
    "on",
    "through",
    "spill",
    "count",
    "misfit",
    "margin",
    "range",
    "upright",
)
# A rival this far away or turned this much is another place, not the same box again.
_ANOTHER_PLACE_M, _ANOTHER_HEADING_RAD = 0.7, 0.4
_MARGIN_CAP = 10.0
# Objects shorter than tall (people): the same error in metres costs them more overlap.
_UPRIGHT = 1.2


def features_of(decision: Decision) -> Floats:
    """(F,) what the probability is computed from, in the order of FEATURES."""
    row, evidence = decision.chosen, decision.evidence
    length_m, _, height_m = decision.size.lwh_m
    return np.array(
        [
            1.0,
            np.log1p(evidence.sides[row]),
            np.log1p(evidence.vertical[row]),
            evidence.on[row],
            evidence.through[row],
            evidence.spill[row],
            evidence.count[row],
            evidence.misfit[row],
            margin(decision) / 5,
            np.log(np.hypot(*decision.parameters[row, [X, Z]]).clip(1)),
            float(height_m * _UPRIGHT > length_m),
        ]
    )


def margin(decision: Decision) -> float:
    """By how much the best box of another place or heading is less likely; at most 10."""
    boxes, chosen = decision.parameters, decision.parameters[decision.chosen]
    turned = (boxes[:, YAW] - chosen[YAW] + np.pi / 2) % np.pi - np.pi / 2
    away = np.hypot(boxes[:, X] - chosen[X], boxes[:, Z] - chosen[Z])
    rivals = (away > _ANOTHER_PLACE_M) | (np.abs(turned) > _ANOTHER_HEADING_RAD)
    lead = decision.energy[rivals] - decision.energy[decision.chosen]
    return float(lead.min(initial=_MARGIN_CAP))


def probability(decision: Decision, iou: float) -> float:
    """Of the chosen box's 3D IoU to exceed `iou`, .5 or .7."""
    evidence = float(features_of(decision) @ np.array(PROBABILITY_WEIGHTS[iou]))
    # The hyperbolic tangent is the logistic that cannot overflow.
    return float((1 + np.tanh(evidence / 2)) / 2)
