"""Overlap of boxes against closed forms, counted grid points and symmetries."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from boxlift.boxes import Boxes3D
from boxlift.camera import Floats
from boxlift.overlap import (
    bev_intersection,
    bev_iou,
    bev_iou_matrix,
    iou_2d,
    iou_3d,
    iou_3d_matrix,
)


def box(
    x: float = 0,
    z: float = 0,
    length: float = 4,
    width: float = 2,
    yaw: float = 0,
    y: float = 0,
    height: float = 1,
) -> Boxes3D:
    one = [np.array([value]) for value in (length, width, height, yaw)]
    return Boxes3D(np.array([[x, y, z]]), *one)


def boxes(rows: Floats) -> Boxes3D:
    """(N, 7) x, y, z, l, w, h, yaw."""
    return Boxes3D(rows[:, :3], *rows[:, 3:].T)


OCTAGON = 8 * (np.sqrt(2) - 1)  # a 2 x 2 square and the same turned by 45 deg


@pytest.mark.parametrize(
    ("a", "b", "area"),
    [
        (box(), box(), 8),
        (box(yaw=0.3), box(yaw=0.3 + np.pi), 8),
        (box(), box(yaw=np.pi / 2), 4),
        (box(length=2), box(length=2, yaw=np.pi / 4), OCTAGON),
        (box(), box(x=1), 6),
        (box(), box(x=1, z=0.5), 4.5),
        (box(), box(length=2, width=1, yaw=0.2), 2),
        (box(length=2, width=1, yaw=0.2), box(), 2),
        # An upright corner region: the diagonal square |u| + |z| <= sqrt(2), moved to one edge, is halved.
        (box(length=20, width=20, x=-10), box(length=2, width=2, yaw=np.pi / 4), 2),
        (box(), box(x=4), 0),
        (box(), box(x=4, z=2), 0),
        (box(), box(x=100), 0),
        (box(), box(length=0), 0),
        (box(length=0, width=0), box(length=0, width=0), 0),
        (box(), box(length=-1, width=-1), 0),
    ],
)
def test_shared_area_of_known_shapes(a: Boxes3D, b: Boxes3D, area: float) -> None:
    np.testing.assert_allclose(bev_intersection(a, b), [area], atol=1e-12)
    np.testing.assert_allclose(bev_intersection(b, a), [area], atol=1e-12)


@pytest.mark.parametrize("yaw", [0, 0.1, np.pi / 4, np.pi / 2, -np.pi, 2.9])
@pytest.mark.parametrize("center", [(0.0, 0.0), (-37.123, 71.9)])
def test_a_box_overlaps_itself_wholly(yaw: float, center: tuple[float, float]) -> None:
    a = box(*center, length=3.9, width=1.6, yaw=yaw, y=1.7, height=1.5)
    assert bev_iou(a, a) == pytest.approx(1, abs=1e-12)
    assert iou_3d(a, a) == pytest.approx(1, abs=1e-12)


def test_boxes_without_area_have_no_iou() -> None:
    assert bev_iou(box(length=0), box(length=0)) == 0
    assert iou_3d(box(height=0), box(height=0)) == 0
    assert iou_3d(box(height=-1), box()) == 0


def test_iou_3d_counts_the_heights_shared() -> None:
    # 0.5 m of 1 m shared on the whole footprint: 4 m3 of 8 + 8 - 4.
    assert iou_3d(box(), box(y=0.5)) == pytest.approx(1 / 3)
    assert iou_3d(box(), box(height=4)) == pytest.approx(1 / 4)
    assert iou_3d(box(), box(y=1)) == 0


def test_iou_of_image_boxes() -> None:
    a = np.array([[0.0, 0, 10, 10], [0, 0, 10, 10], [0, 0, 10, 10], [0, 0, 0, 0]])
    b = np.array([[0.0, 0, 10, 10], [5, 0, 15, 10], [10, 0, 20, 10], [0, 0, 0, 0]])
    np.testing.assert_allclose(iou_2d(a, b), [1, 1 / 3, 0, 0])


def test_matrices_hold_every_pair() -> None:
    a = boxes(np.array([[0, 0, 0, 4, 2, 1, 0], [0, 0, 0, 4, 2, 1, 1.0]]))
    b = boxes(np.array([[0, 0, 0, 4, 2, 1, 0], [1, 0, 0, 4, 2, 1, 0], [9, 0, 9, 4, 2, 1, 0.0]]))
    for matrix, pairwise in ((bev_iou_matrix(a, b), bev_iou), (iou_3d_matrix(a, b), iou_3d)):
        assert matrix.shape == (2, 3)
        for i in range(2):
            for j in range(3):
                assert matrix[i, j] == pairwise(a[i : i + 1], b[j : j + 1])[0]
    assert bev_iou_matrix(a, Boxes3D.empty()).shape == (2, 0)
    assert bev_iou_matrix(Boxes3D.empty(), Boxes3D.empty()).shape == (0, 0)


def _footprint_contains(a: Boxes3D, points: Floats) -> NDArray[np.bool_]:
    """(K, 2) x, z -> (K,) whether inside the footprint of the one box."""
    offset = points - a.center_cam[0, [0, 2]]
    cos, sin = np.cos(a.rotation_y[0]), np.sin(a.rotation_y[0])
    along, across = cos * offset[:, 0] - sin * offset[:, 1], sin * offset[:, 0] + cos * offset[:, 1]
    inside: NDArray[np.bool_] = (np.abs(along) <= a.length_m[0] / 2) & (np.abs(across) <= a.width_m[0] / 2)
    return inside


SIZES = st.floats(0.3, 6)
one_box = st.builds(
    box,
    x=st.floats(-3, 3),
    z=st.floats(-3, 3),
    length=SIZES,
    width=SIZES,
    yaw=st.floats(-np.pi, np.pi),
    y=st.floats(-1, 1),
    height=SIZES,
)


@settings(max_examples=60, deadline=None)
@given(one_box, one_box)
def test_shared_area_is_the_share_of_grid_points_in_both(a: Boxes3D, b: Boxes3D) -> None:
    steps, cell_m = 300, 18 / 300
    axis = (np.arange(steps) + 0.5) * cell_m - 9
    points = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    counted = (_footprint_contains(a, points) & _footprint_contains(b, points)).sum() * cell_m**2
    # A convex outline of at most 24 m passes through cells of 6 cm; their errors mostly cancel.
    assert bev_intersection(a, b)[0] == pytest.approx(counted, abs=24 * cell_m / 2)


@settings(max_examples=200, deadline=None)
@given(one_box, one_box)
def test_iou_is_symmetric_and_bounded(a: Boxes3D, b: Boxes3D) -> None:
    for iou in (bev_iou, iou_3d):
        value = iou(a, b)[0]
        assert 0 <= value <= 1
        assert iou(b, a)[0] == pytest.approx(value, abs=1e-10)


@settings(max_examples=200, deadline=None)
@given(one_box, one_box, st.floats(-50, 50), st.floats(-50, 50), st.floats(-np.pi, np.pi))
def test_iou_does_not_change_when_both_boxes_move_together(
    a: Boxes3D, b: Boxes3D, x: float, z: float, turn: float
) -> None:
    def moved(one: Boxes3D) -> Boxes3D:
        old_x, y, old_z = one.center_cam[0]
        cos, sin = np.cos(turn), np.sin(turn)
        center = np.array([[cos * old_x + sin * old_z + x, y, -sin * old_x + cos * old_z + z]])
        return Boxes3D(center, one.length_m, one.width_m, one.height_m, one.rotation_y + turn)

    assert bev_iou(moved(a), moved(b))[0] == pytest.approx(bev_iou(a, b)[0], abs=1e-9)
    assert iou_3d(moved(a), moved(b))[0] == pytest.approx(iou_3d(a, b)[0], abs=1e-9)


@settings(max_examples=100, deadline=None)
@given(one_box, st.floats(-1e-9, 1e-9), st.floats(-1e-9, 1e-9), st.floats(-1e-9, 1e-9))
def test_almost_equal_boxes_overlap_almost_wholly(a: Boxes3D, x: float, z: float, turn: float) -> None:
    b = Boxes3D(a.center_cam + np.array([x, 0, z]), a.length_m, a.width_m, a.height_m, a.rotation_y + turn)
    assert bev_iou(a, b)[0] == pytest.approx(1, abs=1e-7)
