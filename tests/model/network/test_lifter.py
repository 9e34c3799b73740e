from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from boxlift import Calibration
from boxlift.network.geometry import FEATURES, describe, typical_sizes
from boxlift.network.lifter import (
    OUTPUTS,
    PROMPT_SCORE,
    ROI_CHANNELS,
    ROI_SIZE,
    Lifted,
    Lifter,
    answer_of,
    back_project,
    facing_away,
)
from boxlift.network.lifter_loss import lifter_loss
from boxlift.network.lifter_rows import Rows
from boxlift.network.nanodet import NECK_CHANNELS

# P2 of a KITTI drive, with the offsets of its left colour camera.
KITTI_P2 = np.array(
    [
        [721.5377, 0.0, 609.5593, 44.85728],
        [0.0, 721.5377, 172.854, 0.2163791],
        [0.0, 0.0, 1.0, 0.002745884],
    ]
)
BOXES_PX = torch.tensor([[100.0, 170, 260, 250], [600, 175, 640, 205], [800, 160, 830, 240]])
CATEGORIES = torch.tensor([0, 0, 2])
SIZE_PX = torch.tensor(1242.0), torch.tensor(375.0)


def _maps(seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """Maps of an image of 1248 x 384, as NanoDet's trunk gives them."""
    generator = torch.Generator().manual_seed(seed)
    fine, middle, coarse = (
        torch.randn(1, NECK_CHANNELS, 384 // stride, 1248 // stride, generator=generator)
        for stride in (8, 16, 32)
    )
    return fine, middle, coarse


def _lift(lifter: Lifter, boxes_px: Tensor = BOXES_PX, categories: Tensor = CATEGORIES) -> Lifted:
    scores = torch.full((len(boxes_px),), PROMPT_SCORE)
    with torch.no_grad():
        return lifter.eval().lift(_maps(), boxes_px, categories, scores, _float(KITTI_P2), SIZE_PX)


def _float(matrix: object) -> Tensor:
    return torch.tensor(matrix, dtype=torch.float32)


def _raw(voices: int = 1, count: int = 1, **columns: tuple[int, float]) -> Tensor:
    """Raw outputs that are zero but for column = (index, value)."""
    raw = torch.zeros(voices, count, OUTPUTS)
    for index, value in columns.values():
        raw[..., index] = value
    return raw


def _decided(raw: Tensor, depth_m: float = 20.0, *, learn_sizes: bool = False) -> Lifted:
    lifter = Lifter(blind=raw.shape[0], seeing=0, learn_sizes=learn_sizes)
    return lifter.decide(raw, BOXES_PX[1:2], CATEGORIES[1:2], torch.tensor([depth_m]), _float(KITTI_P2))


@settings(deadline=None, max_examples=50)
@given(
    st.lists(
        st.tuples(st.floats(-500, 2000), st.floats(-500, 1000), st.floats(0.5, 120)), min_size=1, max_size=5
    ),
    st.sampled_from([KITTI_P2, KITTI_P2 + np.array([[0, 3.5, 0, 0], [0, 0, 0, -5], [0, 0, 0, 0.3]])]),
)
def test_back_project_is_that_of_calibration(
    points: list[tuple[float, float, float]], image_P_cam: np.ndarray[tuple[int, int], np.dtype[np.float64]]
) -> None:
    table = np.array(points)
    calibration = Calibration(image_P_cam, np.eye(4))
    found = back_project(
        torch.tensor(table[:, :2]), torch.tensor(table[:, 2]), torch.tensor(np.array(calibration.image_P_cam))
    )
    expected = calibration.back_project(table[:, :2], table[:, 2])
    np.testing.assert_allclose(found.numpy(), expected, rtol=1e-9, atol=1e-9)
    pixels, depth_m = calibration.project(found.numpy())
    np.testing.assert_allclose(pixels, table[:, :2], atol=1e-6)
    np.testing.assert_allclose(depth_m, table[:, 2], rtol=1e-9)


@settings(deadline=None)
@given(st.floats(-10, 10))
def test_facing_away_is_half_a_turn_at_most(rotation_y: float) -> None:
    away = float(facing_away(torch.tensor(rotation_y, dtype=torch.float64)))
    assert -math.pi <= away <= 0
    assert math.remainder(away - rotation_y, math.pi) == pytest.approx(0, abs=1e-9)
    # The heading is (cos, 0, -sin): it leads from the camera.
    assert -math.sin(away) >= -1e-12


@pytest.mark.parametrize(("blind", "seeing"), [(4, 4), (0, 2), (2, 0)])
def test_new_lifter_agrees_with_geometry(blind: int, seeing: int) -> None:
    torch.manual_seed(0)
    lifter = Lifter(blind, seeing)
    found = _lift(lifter)
    scores = torch.full((len(BOXES_PX),), PROMPT_SCORE)
    geometry = describe(BOXES_PX, CATEGORIES, scores, _float(KITTI_P2), SIZE_PX)
    pixels, depth_m = Calibration(KITTI_P2, np.eye(4)).project(found.centers_cam.double().numpy())
    np.testing.assert_allclose(depth_m, geometry.depth_m, rtol=0.1)
    middles, sides = (BOXES_PX[:, :2] + BOXES_PX[:, 2:]) / 2, BOXES_PX[:, 2:] - BOXES_PX[:, :2]
    assert (np.abs(pixels - middles.numpy()) < 0.1 * sides.numpy()).all()
    assert torch.equal(found.sizes_m, typical_sizes()[CATEGORIES])
    assert ((found.scores > 0.4) & (found.scores < 0.6)).all()
    assert ((found.depth_spread > 0.05) & (found.depth_spread < 0.25)).all()


def test_no_boxes_are_lifted_to_none() -> None:
    found = _lift(Lifter(), torch.empty(0, 4), torch.empty(0, dtype=torch.int64))
    assert [tuple(column.shape) for column in found] == [(0, 3), (0, 3), (0,), (0,), (0,)]


def test_lifter_sees_and_hears() -> None:
    torch.manual_seed(0)
    geometry, rois = torch.randn(5, FEATURES), torch.randn(5, ROI_CHANNELS, ROI_SIZE, ROI_SIZE)
    lifter = Lifter(blind=2, seeing=1).eval()
    with torch.no_grad():
        raw, other = lifter(geometry, rois), lifter(geometry, rois.flip(0))
    assert raw.shape == (3, 5, OUTPUTS)
    assert torch.equal(raw[:2], other[:2])
    assert not torch.equal(raw[2], other[2])
    assert lifter.sees
    assert not Lifter(blind=2, seeing=0).sees
    # What makes one like it.
    shape: dict[str, Any] = lifter.shape
    assert Lifter(**shape).state_dict().keys() == lifter.state_dict().keys()


def test_features_are_normalised() -> None:
    torch.manual_seed(0)
    lifter = Lifter(blind=0, seeing=1).eval()
    geometry, rois = torch.randn(2, FEATURES), torch.randn(2, ROI_CHANNELS, ROI_SIZE, ROI_SIZE)
    with torch.no_grad():
        before = lifter(geometry, rois)
        lifter.mean.fill_(3.0)
        lifter.deviation.fill_(2.0)
        torch.testing.assert_close(lifter(geometry, 2 * rois + 3), before)


@pytest.mark.parametrize("local", [-3.0, -1.6, -0.8, 0.0, 0.5, 1.5])
def test_headings_from_double_angles(local: float) -> None:
    """sine and cosine of twice the local orientation, any length of the pair, any number of voices."""
    raw = _raw(2, sine=(4, 0.4 * math.sin(2 * local)), cosine=(5, 0.4 * math.cos(2 * local)))
    found = _decided(raw)
    x, _, z = found.centers_cam[0].tolist()
    heading = float(found.rotations_y[0])
    assert math.remainder(heading - local - math.atan2(x, z), math.pi) == pytest.approx(0, abs=1e-5)
    assert -math.pi <= heading <= 1e-6


def test_depth_is_a_factor_on_geometry() -> None:
    found = _decided(_raw(depth=(0, math.log(1.2))))
    assert float(found.centers_cam[0, 2]) == pytest.approx(24 - KITTI_P2[2, 3], rel=1e-5)


def test_voices_that_disagree_know_less() -> None:
    raw = _raw(2)
    alone = _decided(raw)
    raw[0, :, 0], raw[1, :, 0] = 0.1, -0.1
    found = _decided(raw)
    assert float(found.centers_cam[0, 2]) == pytest.approx(float(alone.centers_cam[0, 2]), rel=1e-5)
    difference = float(found.depth_spread[0] - alone.depth_spread[0])
    assert difference == pytest.approx(math.sqrt(2) * 0.1, rel=1e-4)


def test_offset_is_a_share_of_the_box() -> None:
    found = _decided(_raw(across=(2, 0.25), down=(3, -0.5)))
    pixels, _ = Calibration(KITTI_P2, np.eye(4)).project(found.centers_cam.double().numpy())
    np.testing.assert_allclose(pixels, [[630, 175]], atol=1e-3)


@pytest.mark.parametrize("learn_sizes", [False, True])
def test_sizes_are_learned_only_where_asked(learn_sizes: bool) -> None:
    raw = _raw(length=(6, 2.0), width=(7, -1.0), height=(8, 0.5))
    found = _decided(raw, learn_sizes=learn_sizes)
    expected = typical_sizes()[0]
    if learn_sizes:
        expected = expected * torch.exp(torch.tensor([0.2, -0.1, 0.05]))
    torch.testing.assert_close(found.sizes_m[0], expected)


def test_only_seeing_voices_judge_whether_there_is_an_object() -> None:
    raw = torch.zeros(2, 1, OUTPUTS)
    raw[0, :, 9], raw[1, :, 9] = -5.0, 1.0
    lifter = Lifter(blind=1, seeing=1)
    found = lifter.decide(raw, BOXES_PX[:1], CATEGORIES[:1], torch.tensor([20.0]), _float(KITTI_P2))
    assert float(found.scores[0]) == pytest.approx(1 / (1 + math.exp(-1)))


def test_spread_stays_in_its_range() -> None:
    low, high = (answer_of(_raw(spread=(1, value))).spread_log for value in (-100.0, 100.0))
    assert math.exp(float(low)) == pytest.approx(math.exp(-6.0))
    assert math.exp(float(high)) == pytest.approx(math.exp(-0.5))


def _rows(count: int = 6) -> Rows:
    torch.manual_seed(1)
    return Rows(
        geometry=torch.randn(count, FEATURES),
        rois=torch.randn(count, ROI_CHANNELS, ROI_SIZE, ROI_SIZE),
        depth_log=0.1 * torch.randn(count),
        offset=0.05 * torch.randn(count, 2),
        double_angle=torch.nn.functional.normalize(torch.randn(count, 2)),
        size_log=0.1 * torch.randn(count, 3),
        weight=torch.rand(count),
        is_object=torch.rand(count),
    )


def test_every_weight_learns() -> None:
    rows, lifter = _rows(), Lifter(blind=1, seeing=1, dropout=0.0)
    terms = lifter_loss(lifter(rows.geometry, rows.rois), rows)
    torch.autograd.backward(torch.stack(list(terms.values())).sum())
    for name, parameter in lifter.named_parameters():
        assert parameter.grad is not None, name
        assert torch.isfinite(parameter.grad).all(), name
        assert parameter.grad.abs().max() > 0, name


def test_boxes_without_weight_teach_only_whether_there_is_an_object() -> None:
    rows, lifter = _rows(), Lifter(blind=1, seeing=0)
    raw = lifter(rows.geometry, None).detach()
    nothing = lifter_loss(raw, replace(rows, weight=torch.zeros(len(rows))))
    assert {name for name, term in nothing.items() if float(term)} == {"object"}
    assert float(nothing["object"]) == pytest.approx(float(lifter_loss(raw, rows)["object"]))
    # And weights count in proportion only.
    twice = lifter_loss(raw, replace(rows, weight=2 * rows.weight))
    for name, term in lifter_loss(raw, rows).items():
        torch.testing.assert_close(twice[name], term)
