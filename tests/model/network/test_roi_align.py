from __future__ import annotations

import pytest
import torch
from torch import Tensor, nn

from boxlift.network.roi_align import roi_align
from model.network.exporting import run_exported

BOXES_PX = torch.tensor(
    [[10.0, 20, 300, 150], [0, 0, 624, 192], [-20, 100, 60, 220], [33.3, 40.1, 35.2, 48.8]],
    dtype=torch.float64,
)


def _by_loops(features: Tensor, boxes_px: Tensor, stride: float, size: int, samples: int) -> Tensor:
    """What roi_align says, sample by sample."""
    channels, height, width = features.shape[1:]
    pooled = torch.zeros(len(boxes_px), channels, size, size, dtype=features.dtype)
    for n, (x1, y1, x2, y2) in enumerate(boxes_px.tolist()):
        for row in range(size * samples):
            for column in range(size * samples):
                # Half a cell: the value of cell 0 lies at its middle.
                y = (y1 + (y2 - y1) * (row + 0.5) / (size * samples)) / stride - 0.5
                x = (x1 + (x2 - x1) * (column + 0.5) / (size * samples)) / stride - 0.5
                y, x = min(max(y, 0), height - 1), min(max(x, 0), width - 1)
                top, left = min(int(y), height - 2), min(int(x), width - 2)
                down, right = y - top, x - left
                value = (
                    features[0, :, top, left] * (1 - down) * (1 - right)
                    + features[0, :, top, left + 1] * (1 - down) * right
                    + features[0, :, top + 1, left] * down * (1 - right)
                    + features[0, :, top + 1, left + 1] * down * right
                )
                pooled[n, :, row // samples, column // samples] += value / samples**2
    return pooled


@pytest.mark.parametrize(("size", "samples"), [(7, 2), (3, 1), (2, 3)])
def test_samples_as_loops_do(size: int, samples: int) -> None:
    features = torch.randn(1, 4, 12, 39, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    expected = _by_loops(features, BOXES_PX, 16, size, samples)
    torch.testing.assert_close(roi_align(features, BOXES_PX, 16, size, samples), expected)


def test_box_of_whole_cells_takes_their_values() -> None:
    features = torch.arange(12.0).reshape(1, 1, 3, 4)
    cells = roi_align(features, torch.tensor([[8.0, 8, 24, 24]]), stride=8, size=2, samples=1)
    torch.testing.assert_close(cells[0, 0], torch.tensor([[5.0, 6], [9, 10]]))


def test_gradients() -> None:
    features = torch.randn(1, 2, 4, 6, dtype=torch.float64, requires_grad=True)
    boxes_px = torch.tensor([[9.1, 11.3, 60.7, 40.9]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda f, b: roi_align(f, b, 16, size=2), (features, boxes_px))


def test_no_boxes_give_no_features() -> None:
    assert roi_align(torch.zeros(1, 5, 4, 4), torch.zeros(0, 4), 8).shape == (0, 5, 7, 7)


class _Aligned(nn.Module):
    def forward(self, features: Tensor, boxes_px: Tensor) -> Tensor:
        return roi_align(features, boxes_px, 16)


def test_exports_with_any_number_of_boxes_and_any_map() -> None:
    boxes_px = BOXES_PX.float()
    calls = [
        (torch.randn(1, 8, height, width), boxes_px[:count])
        for count, height, width in ((4, 12, 39), (1, 24, 78), (0, 24, 78))
    ]
    free = ({2: "height", 3: "width"}, {0: "boxes"})
    for (features, boxes), (exported,) in zip(
        calls, run_exported(_Aligned(), calls[0], free, *calls), strict=True
    ):
        torch.testing.assert_close(exported, roi_align(features, boxes, 16), atol=1e-5, rtol=1e-5)
