"""The losses against recorded values, closed forms, gradients and the paper's own argument."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
import torch
from torch import Tensor

from boxlift.losses import (
    BevBoxes,
    balanced_loss,
    center_distance,
    geometric_alignment,
    point_density,
    point_losses,
    ray_tracing,
)
from boxlift.settings import PAPER, RELEASE, LossSettings

ORIGIN = torch.zeros(2, dtype=torch.float64)


def tensor(*values: object) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def one_box(x: float, z: float, rotation_y: float = 0.0, length: float = 4.0, width: float = 2.0) -> BevBoxes:
    return BevBoxes(
        tensor(x, z),
        torch.tensor(length, dtype=torch.float64),
        torch.tensor(width, dtype=torch.float64),
        torch.tensor(rotation_y, dtype=torch.float64),
    )


def test_reproduces_the_authors_implementation(oracle_root: Path) -> None:
    cases = json.loads((oracle_root / "weakm3d_losses.json").read_text())["cases"]

    def column(name: str) -> Tensor:
        return torch.tensor([case[name] for case in cases], dtype=torch.float64)

    boxes = BevBoxes(column("center_xz_m"), column("length_m"), column("width_m"), column("rotation_y_rad"))
    points = column("points_xz_m")
    assert points.shape == (150, 40, 2)
    geometric = geometric_alignment(points, boxes)
    ray, _ = ray_tracing(points, boxes, ORIGIN)
    torch.testing.assert_close(geometric, column("geometric_l1_m"), rtol=0, atol=1e-4)
    torch.testing.assert_close(ray, column("ray_l1_m"), rtol=0, atol=5e-3)


def test_geometric_alignment_by_hand() -> None:
    # Length 4 along x, width 2 along z. (1, 10): inside, the ray from the centre leaves at x = 2.
    # (0, 13): two metres beyond the far side. (4, 12): the ray leaves at the corner (2, 11).
    points = tensor((1.0, 10.0), (0.0, 13.0), (4.0, 12.0), (2.0, 10.5))
    assert geometric_alignment(points, one_box(0, 10)).tolist() == pytest.approx([1, 2, 3, 0], abs=1e-5)


def test_rotation_follows_kitti() -> None:
    # rotation_y = pi/2 turns the heading to -z: length now runs along z.
    points = tensor((0.0, 12.0), (1.0, 10.0))
    assert geometric_alignment(points, one_box(0, 10, math.pi / 2)).tolist() == pytest.approx(
        [0, 0], abs=1e-5
    )
    # rotation_y = pi/4 heads to (+x, -z): the front's middle lies there, 2 m from the centre.
    front = tensor((math.sqrt(2), 10 - math.sqrt(2)))
    assert geometric_alignment(front[None], one_box(0, 10, math.pi / 4)).item() == pytest.approx(0, abs=1e-5)


def test_ray_tracing_takes_the_nearer_hit() -> None:
    # Straight ahead: the ray enters at z = 9 whether the point lies before, in or behind the box.
    points = tensor((0.0, 8.0), (0.0, 9.0), (0.0, 11.0), (0.0, 14.0))
    distance, hit = ray_tracing(points, one_box(0, 10), ORIGIN)
    assert hit.all()
    assert distance.tolist() == pytest.approx([1, 0, 2, 5])


def test_ray_that_misses_costs_nothing() -> None:
    distance, hit = ray_tracing(tensor((5.0, 10.0)), one_box(0, 10), ORIGIN)
    assert not hit.any()
    assert distance.item() == 0


def test_box_behind_the_origin_is_no_hit() -> None:
    _, hit = ray_tracing(tensor((0.0, 8.0)), one_box(0, -10), ORIGIN)
    assert not hit.any()


def test_origin_inside_the_box_looks_out_through_the_front() -> None:
    distance, hit = ray_tracing(tensor((0.0, 3.0)), one_box(0, 0), ORIGIN)
    assert hit.all()
    assert distance.item() == pytest.approx(2)


def test_ray_origin_is_a_parameter() -> None:
    # From (-10, 10) the ray to (0, 10) runs along x and enters at x = -2.
    distance, _ = ray_tracing(tensor((0.0, 10.0)), one_box(0, 10), tensor(-10.0, 10.0))
    assert distance.item() == pytest.approx(2)


def test_center_distance_norms() -> None:
    points = tensor((3.0, 14.0))
    assert center_distance(points[None], one_box(0, 10)).item() == pytest.approx(5)
    assert center_distance(points[None], one_box(0, 10), "l1").item() == pytest.approx(7)


def test_density_counts_the_point_itself_and_only_valid_ones() -> None:
    points = tensor((0.0, 0.0), (0.3, 0.0), (0.6, 0.0), (0.1, 0.0))
    valid = torch.tensor([True, True, True, False])
    assert point_density(points, valid, 0.4)[:3].tolist() == [2, 3, 2]


def test_balanced_loss_by_hand() -> None:
    """Equation 5 for three points, two of them neighbours (E = 2, 2, 1)."""
    points = tensor((0.0, 13.0), (0.1, 13.0), (1.0, 10.0))
    box = one_box(0, 10)
    valid = torch.ones(3, dtype=torch.bool)
    geometric = geometric_alignment(points, box)
    ray, _ = ray_tracing(points, box, ORIGIN)
    center = center_distance(points, box)
    by_hand = ((geometric + ray + 0.1 * center) / tensor(2.0, 2.0, 1.0)).sum() / 3
    loss = balanced_loss(points, valid, box, ORIGIN, PAPER.loss)
    assert loss.item() == pytest.approx(by_hand.item(), abs=1e-5)
    means = point_losses(points, box, ORIGIN, PAPER.loss).means(valid)
    assert [mean.item() for mean in means] == pytest.approx(
        [geometric.mean().item(), ray.mean().item(), center.mean().item()]
    )


def test_alignment_ambiguity_is_decided_by_ray_tracing() -> None:
    """The paper's figure 4: one face of points, two boxes that align with it equally well."""
    face = torch.stack([torch.linspace(-1.8, 1.8, 30, dtype=torch.float64), torch.full((30,), 20.0)], -1)
    behind, before = one_box(0, 21), one_box(0, 19)
    valid = torch.ones(30, dtype=torch.bool)
    true, false = (point_losses(face, box, ORIGIN, PAPER.loss) for box in (behind, before))
    torch.testing.assert_close(true.geometric.mean(), false.geometric.mean())
    torch.testing.assert_close(true.center.mean(), false.center.mean())
    assert true.ray_tracing.max().item() == pytest.approx(0, abs=1e-9)
    assert false.ray_tracing.min().item() > 1.9  # the near side is 2 m before the points
    losses = [balanced_loss(face, valid, box, ORIGIN, PAPER.loss) for box in (behind, before)]
    assert losses[0] < losses[1]


def test_release_drops_the_ray_term_under_three_hits_and_near_the_camera() -> None:
    points = tensor((0.0, 11.0), (0.1, 11.0), (9.0, 10.0), (9.5, 10.0))
    valid = torch.ones(4, dtype=torch.bool)
    without_rays = RELEASE.loss.model_copy(update={"ray_weight": 0.0})
    with_rays = RELEASE.loss.model_copy(update={"ray_min_hits": 2})
    box = one_box(0, 10)
    dropped = balanced_loss(points, valid, box, ORIGIN, RELEASE.loss)
    assert dropped == balanced_loss(points, valid, box, ORIGIN, without_rays)
    counted = balanced_loss(points, valid, box, ORIGIN, with_rays)
    # Two hits of 2 and 2 m (roughly), E = 2 each: averaged over the hits that adds (1 + 1) / 2.
    assert (counted - dropped).item() == pytest.approx(1.0, abs=0.05)
    near = balanced_loss(points - tensor(0.0, 7.5), valid, one_box(0, 2.5), ORIGIN, with_rays)
    assert near == balanced_loss(points - tensor(0.0, 7.5), valid, one_box(0, 2.5), ORIGIN, without_rays)


@pytest.mark.parametrize("settings", [PAPER.loss, RELEASE.loss], ids=["paper", "release"])
def test_padding_and_batching_change_nothing(settings: LossSettings) -> None:
    torch.manual_seed(0)
    points = torch.randn(3, 20, 2, dtype=torch.float64) + tensor(2.0, 15.0)
    valid = torch.arange(20) < torch.tensor([[20], [12], [7]])
    centers = torch.randn(5, 3, 2, dtype=torch.float64) + tensor(2.0, 15.0)
    sizes = [torch.full((3,), v, dtype=torch.float64) for v in (4.0, 1.8)]
    rotation = tensor(0.1, 0.7, -1.2)
    loss = balanced_loss(points, valid, BevBoxes(centers, sizes[0], sizes[1], rotation), ORIGIN, settings)
    assert loss.shape == (5, 3)
    for candidate in range(5):
        for item in range(3):
            alone = balanced_loss(
                points[item][valid[item]],
                valid[item][valid[item]],
                BevBoxes(centers[candidate, item], sizes[0][item], sizes[1][item], rotation[item]),
                ORIGIN,
                settings,
            )
            assert loss[candidate, item].item() == pytest.approx(alone.item(), abs=1e-12)


def test_no_valid_point_is_no_loss() -> None:
    loss = balanced_loss(
        torch.zeros(4, 2, dtype=torch.float64),
        torch.zeros(4, dtype=torch.bool),
        one_box(0, 10),
        ORIGIN,
        PAPER.loss,
    )
    assert loss.item() == 0


@pytest.mark.parametrize("settings", [PAPER.loss, RELEASE.loss], ids=["paper", "release"])
def test_gradients_of_every_box_parameter(settings: LossSettings) -> None:
    """gradcheck in double precision, away from the kinks of the absolute values."""
    torch.manual_seed(3)
    points = torch.randn(2, 15, 2, dtype=torch.float64) + tensor(1.0, 12.0)
    valid = torch.arange(15) < torch.tensor([[15], [9]])
    density = point_density(points, valid, settings.density_radius_m)

    def total(center: Tensor, length: Tensor, width: Tensor, rotation: Tensor, at: Tensor) -> Tensor:
        boxes = BevBoxes(center, length, width, rotation)
        return balanced_loss(at, valid, boxes, ORIGIN, settings, density)

    inputs = [
        tensor((1.13, 12.7), (0.61, 13.1)),
        tensor(3.9, 4.2),
        tensor(1.7, 1.9),
        tensor(0.37, -1.03),
        points,
    ]
    assert torch.autograd.gradcheck(total, [value.requires_grad_() for value in inputs])


@pytest.mark.parametrize(
    ("point", "box", "origin"),
    [
        ((0.0, 10.0), (0.0, 10.0), (0.0, 0.0)),  # at the centre
        ((2.0, 10.5), (0.0, 10.0), (0.0, 0.0)),  # on an edge
        ((2.0, 11.0), (0.0, 10.0), (0.0, 0.0)),  # on a corner
        ((0.0, 12.0), (0.0, 10.0), (0.0, 0.0)),  # ray parallel to the sides, through the box
        ((2.0, 12.0), (0.0, 10.0), (2.0, 0.0)),  # ray along a side
        ((5.0, 12.0), (0.0, 10.0), (5.0, 0.0)),  # ray parallel to a side, beside the box
        ((0.0, 10.0), (0.0, 0.0), (0.0, 0.0)),  # camera inside the box, at its centre
        ((0.5, 0.2), (0.0, 0.0), (0.1, 0.1)),  # camera and point inside the box
        ((1.0, 5.0), (0.0, 10.0), (1.0, 5.0)),  # point at the camera
    ],
)
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_values_and_gradients_are_finite_everywhere(
    point: tuple[float, float], box: tuple[float, float], origin: tuple[float, float], dtype: torch.dtype
) -> None:
    center = torch.tensor(box, dtype=dtype, requires_grad=True)
    length, width, rotation = (
        torch.tensor(value, dtype=dtype, requires_grad=True) for value in (4.0, 2.0, 0.0)
    )
    points = torch.tensor([point], dtype=dtype, requires_grad=True)
    valid = torch.ones(1, dtype=torch.bool)
    at = torch.tensor(origin, dtype=dtype)
    loss = balanced_loss(points, valid, BevBoxes(center, length, width, rotation), at, PAPER.loss)
    gradients = torch.autograd.grad(loss, [points, center, length, width, rotation])
    assert torch.isfinite(loss)
    assert all(torch.isfinite(gradient).all() for gradient in gradients)


def test_point_at_the_center_is_as_far_as_the_side() -> None:
    """The value there continues the values around it instead of dropping to zero."""
    box = one_box(0, 10)
    at, beside = geometric_alignment(tensor((0.0, 10.0), (0.0, 10.001)), box).tolist()
    assert at == pytest.approx(1.0, abs=1e-5)
    assert beside == pytest.approx(0.999, abs=1e-5)
