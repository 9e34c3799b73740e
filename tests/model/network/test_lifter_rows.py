from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
import torch

from boxlift.boxes import Boxes3D
from boxlift.camera import Calibration
from boxlift.network.config import AugmentationSettings, RowSettings
from boxlift.network.geometry import FEATURES, describe, typical_sizes
from boxlift.network.lifter import PROMPT_SCORE, ROI_CHANNELS, ROI_SIZE, Lifter
from boxlift.network.lifter_rows import Rows, is_surest, probabilities, rows_of_frame
from boxlift.network.lifter_task import FrozenTrunk
from boxlift.network.training_frames import TrainingFrame
from model.network.lifter_data import training_frames, write_frames

STILL = AugmentationSettings()
MIRRORED = AugmentationSettings(flip=1)


@pytest.fixture(scope="module")
def frame(tmp_path_factory: pytest.TempPathFactory) -> TrainingFrame:
    """Cars and persons with exact boxes; detector scores that differ."""
    found = training_frames(write_frames(tmp_path_factory.mktemp("generated")))[0]
    return replace(found, score=np.linspace(0.55, 0.95, len(found.score)))


@pytest.fixture(scope="module")
def trunk() -> FrozenTrunk:
    torch.set_num_threads(1)
    return FrozenTrunk()


def _rows(
    frame: TrainingFrame,
    trunk: FrozenTrunk,
    augmentation: AugmentationSettings = STILL,
    seed: int = 0,
    **changes: object,
) -> Rows:
    plain: dict[str, object] = {"views": 1, "shifts": 0, "drawn": False, "largest_disagreement": 5.0}
    return rows_of_frame(frame, trunk, RowSettings.model_validate(plain | changes), augmentation, seed)


def _labelled(frame: TrainingFrame, **columns: Any) -> TrainingFrame:
    """The frame with other targets."""
    return replace(frame, targets=replace(frame.targets, **columns))


def _boxes(frame: TrainingFrame) -> Boxes3D:
    targets = frame.targets
    length, width, height = targets.size_m.T
    return Boxes3D(targets.center_cam, length, width, height, targets.rotation_y)


def test_columns(frame: TrainingFrame, trunk: FrozenTrunk) -> None:
    rows, count = _rows(frame, trunk, views=3, shifts=2), len(frame.score)
    assert len(rows) == 3 * 3 * count
    assert rows.geometry.shape == (len(rows), FEATURES)
    assert rows.rois.shape == (len(rows), ROI_CHANNELS, ROI_SIZE, ROI_SIZE)
    assert rows.rois.dtype == torch.float16
    for column in fields(rows):
        assert torch.isfinite(getattr(rows, column.name)).all(), column.name
    picked = rows.of(torch.tensor([4, 1]))
    assert torch.equal(picked.depth_log, rows.depth_log[[4, 1]])
    joined = Rows.joined([picked, rows])
    assert len(joined) == len(rows) + 2
    assert torch.equal(joined.offset[2:], rows.offset)


def test_perfect_answers_give_the_labels_back(frame: TrainingFrame, trunk: FrozenTrunk) -> None:
    """What rows ask for, put into the head's decision, is the label: offsets of P and all."""
    P = frame.image_P_cam + np.array([[0, 0, 0, 15.0], [0, 0, 0, 0.2], [0, 0, 0, 0.003]])
    elsewhere = replace(frame, image_P_cam=P)
    rows = _rows(elsewhere, trunk)
    raw = torch.zeros(1, len(rows), 10)
    raw[0, :, 0], raw[0, :, 2:4], raw[0, :, 4:6] = rows.depth_log, rows.offset, rows.double_angle
    raw[0, :, 6:9] = rows.size_log * 10
    boxes_px, category = torch.from_numpy(frame.boxes_px).float(), torch.from_numpy(frame.category)
    projection = torch.tensor(P, dtype=torch.float32)
    size = torch.tensor(416.0), torch.tensor(125.0)
    geometry = describe(boxes_px, category, torch.from_numpy(frame.score).float(), projection, size)
    lifter = Lifter(1, 0, learn_sizes=True)
    found = lifter.decide(raw, boxes_px, category, geometry.depth_m, projection)
    np.testing.assert_allclose(found.centers_cam, frame.targets.center_cam, atol=2e-3)
    np.testing.assert_allclose(found.sizes_m, frame.targets.size_m, rtol=1e-4)
    turned = found.rotations_y.double().numpy() - frame.targets.rotation_y
    np.testing.assert_allclose(np.sin(turned), 0, atol=1e-3)


def test_weights_are_what_the_labeller_is_sure_of(frame: TrainingFrame, trunk: FrozenTrunk) -> None:
    """The 2D score is taken out of a label's weight; unsure labels teach no box, and are rather no object."""
    sure = np.linspace(0.1, 0.9, len(frame.score))
    judged = _labelled(frame, weight=sure * frame.score)
    np.testing.assert_allclose(probabilities(judged), sure)
    rows = _rows(judged, trunk, least_probability=0.3)
    np.testing.assert_allclose(rows.is_object, sure, rtol=1e-6)
    np.testing.assert_allclose(rows.weight, np.where(sure < 0.3, 0, sure), rtol=1e-6)


def test_boxes_without_a_label_are_no_objects(frame: TrainingFrame, trunk: FrozenTrunk) -> None:
    weight = frame.targets.weight.copy()
    weight[2] = 0
    rows = _rows(_labelled(frame, weight=weight), trunk, least_probability=0.0)
    assert rows.weight[2] == rows.is_object[2] == 0
    assert (rows.weight[:2] > 0).all()


def test_labels_that_contradict_the_height_teach_no_box(frame: TrainingFrame, trunk: FrozenTrunk) -> None:
    """A label on the wall behind a car: twice as far as the car's height says."""
    center = frame.targets.center_cam.copy()
    center[1] *= 2
    rows = _rows(_labelled(frame, center_cam=center), trunk, largest_disagreement=0.4)
    assert rows.weight[1] == 0
    assert rows.is_object[1] == 1
    assert rows.depth_log[1] == pytest.approx(np.log(2), abs=0.3)
    kept = torch.arange(len(rows)) != 1
    assert (rows.weight[kept] > 0).sum() >= 7


def test_labels_behind_the_camera_teach_no_box(frame: TrainingFrame, trunk: FrozenTrunk) -> None:
    center = frame.targets.center_cam.copy()
    center[0] = 1.0, 1.0, 1.5
    rows = _rows(_labelled(frame, center_cam=center), trunk)
    assert rows.weight[0] == 0
    assert all(torch.isfinite(getattr(rows, column.name)).all() for column in fields(rows))


def test_of_boxes_with_one_label_the_surest_counts(frame: TrainingFrame, trunk: FrozenTrunk) -> None:
    targets = frame.targets
    center, size, heading = (
        column.copy() for column in (targets.center_cam, targets.size_m, targets.rotation_y)
    )
    center[3], size[3], heading[3] = center[4] + [0.2, 0, 0.1], size[4], heading[4]
    doubled = _labelled(frame, center_cam=center, size_m=size, rotation_y=heading)
    alone = is_surest(doubled)
    assert np.flatnonzero(~alone).tolist() == [3]  # scores rise from row to row
    assert is_surest(replace(doubled, score=doubled.score[::-1])).tolist() == [
        row != 4 for row in range(len(alone))
    ]
    rows = _rows(doubled, trunk, duplicate_weight=0.25)
    assert rows.weight[3] == pytest.approx(0.25)
    assert rows.is_object[3] == 0
    assert rows.weight[4] == rows.is_object[4] == 1
    # A box that has no label is no rival.
    weight = targets.weight.copy()
    weight[4] = 0
    assert is_surest(_labelled(doubled, weight=weight)).all()


def test_mirrored_views_are_consistent(frame: TrainingFrame, trunk: FrozenTrunk) -> None:
    rows, count = _rows(frame, trunk, MIRRORED, views=2), len(frame.score)
    plain, mirrored = rows.of(torch.arange(count)), rows.of(torch.arange(count, 2 * count))
    torch.testing.assert_close(mirrored.depth_log, plain.depth_log, rtol=0, atol=1e-5)
    flipped = torch.tensor([-1.0, 1.0])
    torch.testing.assert_close(mirrored.offset, plain.offset * flipped, rtol=0, atol=1e-4)
    torch.testing.assert_close(mirrored.double_angle, plain.double_angle * flipped, rtol=0, atol=1e-5)
    for column in ("size_log", "weight", "is_object"):
        assert torch.equal(getattr(mirrored, column), getattr(plain, column))
    # Left and right swap (up to the box's own scale), heights stay.
    torch.testing.assert_close(mirrored.geometry[:, 0], -plain.geometry[:, 2], rtol=0, atol=1e-5)
    torch.testing.assert_close(mirrored.geometry[:, [1, 3]], plain.geometry[:, [1, 3]])


def test_drawn_boxes_hold_the_whole_object(frame: TrainingFrame, trunk: FrozenTrunk) -> None:
    """Of some boxes with a user's score, edges are those of the projected label, as people draw them."""
    half = replace(frame, boxes_px=frame.boxes_px.copy())
    widths = half.boxes_px[:, 2] - half.boxes_px[:, 0]
    half.boxes_px[:, 2] -= 0.4 * widths
    rows = _rows(half, trunk, views=12, drawn=True)
    given = (rows.geometry[:, 16] - (2 * PROMPT_SCORE - 0.8)).abs() < 1e-6
    assert 0.15 < given.float().mean() < 0.45
    row_of = torch.arange(len(rows)) % len(frame.score)
    whole = _boxes(frame).project(Calibration(frame.image_P_cam, np.eye(4)))
    right_px = rows.geometry[:, 2].double() / 1.5 * frame.image_P_cam[0, 0] + frame.image_P_cam[0, 2]
    expected = np.where(given, whole[row_of, 2].clip(0, 415), half.boxes_px[row_of, 2])
    np.testing.assert_allclose(right_px, expected, atol=0.01)


def test_shifted_boxes_are_a_little_beside(frame: TrainingFrame, trunk: FrozenTrunk) -> None:
    rows, count = _rows(frame, trunk, shifts=8, shift_share=0.05), len(frame.score)
    heights = rows.geometry[:, 4].reshape(9, count)
    off = heights[1:] - heights[0]
    assert off.abs().max() < 2 * 3 * 0.05 * 1.3
    assert off.std() > 0.02
    # The label stays: its depth against that of the other height.
    depth = rows.depth_log.reshape(9, count)
    assert (depth[1:] - depth[0] - off).abs().max() < 0.1


def test_same_seed_same_rows(frame: TrainingFrame, trunk: FrozenTrunk) -> None:
    changes = AugmentationSettings(flip=0.5, focal=0.2, scale=0.2, color=0.3)
    first, again, other = (
        _rows(frame, trunk, changes, seed=seed, views=3, shifts=1, drawn=True) for seed in (4, 4, 5)
    )
    for column in fields(first):
        assert torch.equal(getattr(first, column.name), getattr(again, column.name)), column.name
    assert not torch.equal(first.geometry, other.geometry)
    renamed = _rows(replace(frame, name="another"), trunk, changes, seed=4, views=3, shifts=1, drawn=True)
    assert not torch.equal(first.geometry, renamed.geometry)


def test_size_targets_are_around_the_typical(frame: TrainingFrame, trunk: FrozenTrunk) -> None:
    rows = _rows(frame, trunk)
    sizes = typical_sizes()[torch.from_numpy(frame.category)] * torch.exp(rows.size_log)
    np.testing.assert_allclose(sizes, frame.targets.size_m, rtol=1e-5)
