"""How far to trust a fitted box: a score in [0, 1] and named flags."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from boxlift.frame import LossTerms, PointCounts

# Flag an object whose cluster has fewer points than this.
_FEW_POINTS = 30


def score_of(losses: LossTerms, points: PointCounts, prompt_score: float) -> float:
    """Rises with the number of points, falls with the distance of points from the box; not calibrated.

    The misfit in metres against 0.15 log(points), through a logistic, times the score of the prompt cut
    to [0, 1] (some detectors write logits): an order, not a probability.
    """
    misfit_m = losses.geometric + losses.ray_tracing
    evidence = 0.15 * math.log(max(points.in_cluster, 1)) - misfit_m
    # The hyperbolic tangent is the logistic that cannot overflow.
    return share_of(prompt_score) * (1 + math.tanh(2 * evidence)) / 2


def share_of(prompt_score: float) -> float:
    """A prompt's score cut to [0, 1]; 0 for one that is no number."""
    return 0.0 if math.isnan(prompt_score) else min(max(prompt_score, 0.0), 1.0)


def flags_of(points: PointCounts, *, truncated: bool, ground_uncertain: bool) -> tuple[str, ...]:
    """Named reasons to look at a box twice, in a fixed order."""
    named = {
        "few_points": points.in_cluster < _FEW_POINTS,
        # Pair directions and frozen sizes say nothing about front and back.
        "heading_ambiguous": True,
        "truncated": truncated,
        "size_from_prior": True,
        "ground_uncertain": ground_uncertain,
    }
    return tuple(name for name, holds in named.items() if holds)
