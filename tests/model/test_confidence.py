from __future__ import annotations

import pytest

from boxlift.confidence import flags_of, score_of
from boxlift.frame import LossTerms, PointCounts


def losses(misfit_m: float) -> LossTerms:
    return LossTerms(geometric=misfit_m, ray_tracing=0.0, center=1.0, total=0.1)


def test_score_falls_with_misfit_and_rises_with_points() -> None:
    scores = [score_of(losses(misfit), PointCounts(in_cluster=50), 1.0) for misfit in (0.05, 0.3, 1.0, 5.0)]
    assert scores == sorted(scores, reverse=True)
    few, many = (score_of(losses(0.2), PointCounts(in_cluster=n), 1.0) for n in (10, 500))
    assert few < many
    assert all(0 < score < 1 for score in (*scores, few, many))


def test_a_box_far_from_its_points_scores_nothing_and_raises_nothing() -> None:
    assert score_of(losses(1e5), PointCounts(in_cluster=50), 1.0) == 0
    assert score_of(losses(0.0), PointCounts(in_cluster=0), 1.0) == 0.5


@pytest.mark.parametrize(("prompt_score", "same_as"), [(-2.0, 0.0), (250.0, 1.0), (float("nan"), 0.0)])
def test_scores_of_prompts_are_cut_to_a_share(prompt_score: float, same_as: float) -> None:
    points = PointCounts(in_cluster=50)
    assert score_of(losses(0.2), points, prompt_score) == score_of(losses(0.2), points, same_as)


def test_score_of_the_prompt_counts() -> None:
    whole, half = (score_of(losses(0.2), PointCounts(in_cluster=50), score) for score in (1.0, 0.5))
    assert half == whole / 2


def test_flags() -> None:
    assert flags_of(PointCounts(in_cluster=12), truncated=True, ground_uncertain=True) == (
        "few_points",
        "heading_ambiguous",
        "truncated",
        "size_from_prior",
        "ground_uncertain",
    )
    assert flags_of(PointCounts(in_cluster=200), truncated=False, ground_uncertain=False) == (
        "heading_ambiguous",
        "size_from_prior",
    )
