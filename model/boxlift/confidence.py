"""How far to trust a fitted box: a score in (0, 1) and named flags."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from boxlift.frame import LossTerms, PointCounts

# Flag an object that the losses saw through fewer points than this.
_FEW_POINTS = 30


def score_of(losses: LossTerms, points: PointCounts, prompt_score: float) -> float:
    """Rises with the number of points, falls with the distance of points from the box; not calibrated.

    The misfit in metres against 0.15 log(points), through a logistic: an order, not a probability.
    """
    misfit_m = losses.geometric + losses.ray_tracing
    evidence = 0.15 * math.log(max(points.in_cluster, 1)) - misfit_m
    return prompt_score / (1 + math.exp(-4 * evidence))


def flags_of(points: PointCounts, *, truncated: bool, ground_found: bool) -> tuple[str, ...]:
    """Named reasons to look at a box twice, in a fixed order."""
    named = {
        "few_points": points.in_cluster < _FEW_POINTS,
        # Pair directions and frozen sizes say nothing about front and back.
        "heading_ambiguous": True,
        "truncated": truncated,
        "size_from_prior": True,
        "ground_uncertain": not ground_found,
    }
    return tuple(name for name, holds in named.items() if holds)
