from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from boxlift.boxes import wrap_angle
from boxlift.network.orientation import bin_middles, decode_alpha, facing_away, orientation_loss, ray_angle

ALPHAS = torch.linspace(-math.pi / 2, math.pi / 2 - 1e-4, 37, dtype=torch.float64)


def _perfect(alpha: Tensor, bins: int) -> Tensor:
    """What a head that knows alpha would say."""
    output = torch.zeros(len(alpha), bins, 3, dtype=alpha.dtype)
    off = 2 * alpha[:, None] - bin_middles(output)
    output[..., 0] = 50 * torch.cos(off)
    output[..., 1], output[..., 2] = torch.cos(off), torch.sin(off)
    return output


@pytest.mark.parametrize("bins", [1, 2, 4, 9])
def test_decodes_what_was_encoded(bins: int) -> None:
    torch.testing.assert_close(decode_alpha(_perfect(ALPHAS, bins)), ALPHAS)


@pytest.mark.parametrize("bins", [2, 5])
def test_loss_is_zero_where_all_is_right(bins: int) -> None:
    away_from_borders = ALPHAS[
        (2 * ALPHAS[:, None] - bin_middles(_perfect(ALPHAS, bins))).abs().min(1).values < 0.4
    ]
    assert orientation_loss(_perfect(away_from_borders, bins), away_from_borders, 0.1).max() < 1e-3


def test_period_is_half_a_turn() -> None:
    output = torch.randn(len(ALPHAS), 2, 3, dtype=torch.float64)
    loss = orientation_loss(output, ALPHAS, 0.1)
    torch.testing.assert_close(orientation_loss(output, ALPHAS + math.pi, 0.1), loss)
    torch.testing.assert_close(orientation_loss(output, ALPHAS - 3 * math.pi, 0.1), loss)


def test_a_right_angle_off_costs_most() -> None:
    right, wrong = _perfect(torch.tensor([0.3]), 1), _perfect(torch.tensor([0.3 + math.pi / 2]), 1)
    losses = [orientation_loss(output, torch.tensor([0.3]), 0.0) for output in (right, wrong)]
    torch.testing.assert_close(torch.cat(losses), torch.tensor([0.0, 2.0]), atol=1e-5, rtol=0)


def test_neighbour_learns_from_what_lies_in_the_overlap() -> None:
    # With two bins the middles are at alpha = -pi/4 and pi/4; their border is 0.
    output = torch.zeros(1, 2, 3, dtype=torch.float64)
    output[..., 1] = 1
    output.requires_grad_()
    for alpha, learning in ((0.02, [True, True]), (0.5, [False, True])):
        (gradient,) = torch.autograd.grad(
            orientation_loss(output, torch.tensor([alpha], dtype=torch.float64), 0.1).sum(), output
        )
        assert (gradient[0, :, 2].abs() > 0).tolist() == learning


def test_gradients() -> None:
    output = torch.randn(5, 3, 3, dtype=torch.float64, requires_grad=True)
    alpha = torch.tensor([0.1, 0.7, -1.2, 1.5, 3.0], dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda o: orientation_loss(o, alpha, 0.1), (output,))


def test_output_of_all_zeros_has_finite_gradients() -> None:
    output = torch.zeros(1, 2, 3, requires_grad=True)
    torch.autograd.backward(orientation_loss(output, torch.tensor([0.1]), 0.1).sum())
    assert output.grad is not None
    assert torch.isfinite(output.grad).all()


def test_facing_away_is_the_same_line() -> None:
    angles = torch.linspace(-7, 7, 57, dtype=torch.float64)
    away = facing_away(angles)
    assert ((away >= -math.pi) & (away < 0)).all()
    turns = ((away - angles) / math.pi).numpy()
    np.testing.assert_allclose(turns, turns.round(), atol=1e-9)


def test_ray_is_that_of_kittis_alpha() -> None:
    center = torch.tensor([[3.0, 1, 20], [-8, 1, 5]])
    expected = wrap_angle(np.arctan2(center[:, 0].numpy(), center[:, 2].numpy()))
    np.testing.assert_allclose(ray_angle(center).numpy(), expected, rtol=1e-6)
