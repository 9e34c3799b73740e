from __future__ import annotations

import numpy as np
import pytest
import torch

from boxlift import Calibration
from boxlift.network.box_parameters import (
    BoxParameters,
    back_project,
    depth_of,
    log_size_of,
    project,
    to_boxes,
)
from model.network.objects import objects, perfect, projections

# With the offsets of KITTI's P2.
P2 = np.array([[721.5, 0, 609.6, 44.9], [0, 721.5, 172.9, 0.216], [0, 0, 1, 0.00275]])


def test_back_projection_is_that_of_calibration() -> None:
    calibration = Calibration(P2, np.eye(4))
    pixels, depth_m = np.array([[100.0, 200], [900, 150]]), np.array([12.0, 40])
    found = back_project(torch.from_numpy(pixels), torch.from_numpy(depth_m), torch.from_numpy(P2))
    np.testing.assert_allclose(found.numpy(), calibration.back_project(pixels, depth_m), atol=1e-9)
    again, depth = project(found, torch.from_numpy(P2))
    np.testing.assert_allclose(again.numpy(), pixels)
    np.testing.assert_allclose(depth.numpy(), depth_m)


def test_perfect_parameters_give_the_drawn_boxes() -> None:
    targets = objects()
    boxes = to_boxes(perfect(targets), projections(targets), targets.frozen_size_m)
    torch.testing.assert_close(boxes.center_cam, targets.center_cam)
    torch.testing.assert_close(boxes.rotation_y, targets.rotation_y)
    torch.testing.assert_close(boxes.size_m, targets.size_m)


@pytest.mark.parametrize("wild", [-1e6, -50.0, 50.0, 1e6])
def test_wild_outputs_stay_finite(wild: float) -> None:
    output = torch.tensor([wild], requires_grad=True)
    depth_m, log_size = depth_of(output), log_size_of(output)
    assert 0.99 < float(depth_m.detach()) < 151
    assert float(log_size.detach().abs()) <= 0.7
    torch.autograd.backward((depth_m + log_size).sum())
    assert output.grad is not None
    assert torch.isfinite(output.grad).all()


def test_no_objects_have_no_boxes() -> None:
    none = BoxParameters(torch.zeros(0, 2), torch.zeros(0), torch.zeros(0, 2, 3), torch.zeros(0, 3))
    boxes = to_boxes(none, torch.from_numpy(P2).float(), torch.zeros(0, 3))
    assert boxes.center_cam.shape == (0, 3)
