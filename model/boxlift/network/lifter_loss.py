"""Regression of voices to cleaned pseudo labels, weighted by how sure those are."""

from __future__ import annotations

from torch import Tensor
from torch.nn import functional

from boxlift.network.lifter import answer_of
from boxlift.network.lifter_rows import Rows

# All ours: they bring the terms to one order of magnitude.
_OFFSET_WEIGHT, _OFFSET_BETA = 5.0, 0.05
_SIZE_WEIGHT = 20.0


def lifter_loss(raw: Tensor, rows: Rows) -> dict[str, Tensor]:
    """Raw outputs (voices, M, 10) and M rows -> terms, means over voices and (weighted) rows.

    Depth has a Laplace likelihood, so that a voice may say that it does not know (Kendall and Gal, "What
    Uncertainties Do We Need", 2017).
    """
    answer = answer_of(raw)
    share = rows.weight / rows.weight.sum().clamp(min=1e-6) / raw.shape[0]
    depth = (answer.depth_log - rows.depth_log).abs() * (-answer.spread_log).exp() + answer.spread_log
    offset = functional.smooth_l1_loss(
        answer.offset, rows.offset.expand_as(answer.offset), reduction="none", beta=_OFFSET_BETA
    ).sum(-1)
    angle = (answer.double_angle - rows.double_angle).square().sum(-1)
    size = (answer.size_log - rows.size_log).square().sum(-1)
    is_object = functional.binary_cross_entropy_with_logits(
        answer.object_logit, rows.is_object.expand_as(answer.object_logit)
    )
    return {
        "depth": (depth * share).sum(),
        "offset": _OFFSET_WEIGHT * (offset * share).sum(),
        "angle": (angle * share).sum(),
        "size": _SIZE_WEIGHT * (size * share).sum(),
        "object": is_object,
    }
