from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from boxlift.network.box_parameters import BoxParameters
from boxlift.network.config import DirectLossSettings
from boxlift.network.direct_loss import box_loss, direct_loss
from boxlift.settings import LossSettings
from model.network.objects import objects, perfect, projections

PAPER = DirectLossSettings()


def _sum(terms: dict[str, torch.Tensor]) -> torch.Tensor:
    return torch.stack(list(terms.values())).sum()


@pytest.mark.parametrize("change", [{"depth_m": 1.1}, {"depth_m": 0.9}, {"center_px": 1.05}])
def test_right_box_costs_least(change: dict[str, float]) -> None:
    targets = objects()
    right = perfect(targets)
    wrong = right._replace(**{name: getattr(right, name) * factor for name, factor in change.items()})
    for loss in (direct_loss, box_loss):
        costs = [_sum(loss(each, targets, projections(targets), PAPER, 0.1)) for each in (right, wrong)]
        assert costs[0] < costs[1]


def test_regression_to_the_drawn_boxes_ends_at_nothing() -> None:
    targets = objects()
    terms = box_loss(perfect(targets), targets, projections(targets), PAPER, 0.1)
    assert {name: round(float(term), 2) for name, term in terms.items()} == {
        "center": 0,
        "depth": 0,
        "orientation": 0,
        "size": 0,
    }


@pytest.mark.parametrize("heading", ["points", "predicted"])
def test_gradients(heading: str) -> None:
    targets = objects(points=20)
    settings = DirectLossSettings.model_validate({"heading": heading})
    start = perfect(targets)
    inputs = [column.clone().requires_grad_() for column in start]
    # A little off, away from the kinks at the exact box.
    off = [0.02 * torch.randn_like(column) for column in start]

    def total(*columns: torch.Tensor) -> torch.Tensor:
        moved = BoxParameters(*(column + step for column, step in zip(columns, off, strict=True)))
        # The target of the orientation sees the centre without its gradient: not part of this check.
        terms = direct_loss(moved, targets, projections(targets), settings, 0.1)
        return terms["alignment"] + terms["y"]

    assert torch.autograd.gradcheck(total, inputs)


@pytest.mark.parametrize("depth_m", [0.0, 1e-3, 1.0, 5000.0])
@pytest.mark.parametrize("column_px", [-5e4, 600.0, 5e4])
def test_boxes_anywhere_have_finite_gradients(depth_m: float, column_px: float) -> None:
    """A network may say anything at first: boxes around the camera, far beyond, and to all sides."""
    targets = objects(torch.float32)
    parameters = perfect(targets)
    center_px = torch.full_like(parameters.center_px, column_px).requires_grad_()
    depth = torch.full_like(parameters.depth_m, depth_m).requires_grad_()
    moved = parameters._replace(center_px=center_px, depth_m=depth)
    total = _sum(direct_loss(moved, targets, projections(targets), PAPER, 0.1))
    torch.autograd.backward(total)
    assert torch.isfinite(total)
    for leaf in (center_px, depth):
        assert leaf.grad is not None
        assert torch.isfinite(leaf.grad).all()


def test_switches_switch_off() -> None:
    targets = objects()
    moved = perfect(targets)
    moved = moved._replace(depth_m=moved.depth_m * 1.05)

    def alignment(**changes: object) -> float:
        settings = DirectLossSettings(alignment=LossSettings.model_validate(changes))
        return float(direct_loss(moved, targets, projections(targets), settings, 0.1)["alignment"])

    everything = alignment()
    assert alignment(geometric_weight=0) < everything
    assert alignment(ray_weight=0) < everything
    assert alignment(center_weight=0) < everything
    assert alignment(balance_by_density=False) > everything
    assert alignment(geometric_weight=0, ray_weight=0, center_weight=0) == 0


def test_object_of_no_weight_is_not_seen() -> None:
    targets = objects()
    without = replace(targets, weight=torch.tensor([1.0, 0.0, 1.0], dtype=torch.float64))
    parameters = perfect(targets)
    elsewhere = parameters.depth_m.clone()
    elsewhere[1] = 70
    for loss in (direct_loss, box_loss):
        costs = [
            _sum(loss(parameters._replace(depth_m=depth), without, projections(targets), PAPER, 0.1))
            for depth in (parameters.depth_m, elsewhere)
        ]
        assert costs[0] == costs[1]
    nothing = replace(targets, weight=torch.zeros(3, dtype=torch.float64))
    assert _sum(direct_loss(parameters, nothing, projections(targets), PAPER, 0.1)) == 0


def test_weights_of_terms_and_y_from_points() -> None:
    targets = objects()
    high = replace(targets, points_cam=targets.points_cam - torch.tensor([0.0, 3.0, 0.0]))
    terms = direct_loss(perfect(targets), high, projections(targets), DirectLossSettings(y_weight=2), 0.1)
    mean_y = high.points_cam[..., 1].mean(1)
    expected = 2 * ((targets.center_cam[:, 1] - mean_y).abs() - 0.5).mean()
    torch.testing.assert_close(terms["y"], expected)
