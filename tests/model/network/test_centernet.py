from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor, nn

from boxlift.network.batch import FrameBatch
from boxlift.network.centernet import (
    STRIDE,
    CenterNetwork,
    DenseMaps,
    detection_loss,
    find_peaks,
    object_cells,
    parameters_at,
    target_heat,
)
from boxlift.network.config import ModelSettings
from model.network.exporting import padded, run_exported
from model.network.objects import PROJECTION, objects, perfect

HEIGHT, WIDTH = 384 // STRIDE, 1248 // STRIDE


def _batch() -> FrameBatch:
    cars = objects(torch.float32)
    return FrameBatch(torch.zeros(1, 3, 384, 1248), PROJECTION.float()[None], [3], cars)


def _perfect_maps(batch: FrameBatch) -> DenseMaps:
    """Maps that say exactly what the objects are, at their cells."""
    parameters, boxes_px = perfect(batch.objects), batch.objects.boxes_px
    empty = DenseMaps(
        heat=torch.full((1, 1, HEIGHT, WIDTH), -20.0),
        **{name: torch.zeros(1, 2, HEIGHT, WIDTH) for name in ("extent", "to_middle", "to_center")},
        depth=torch.zeros(1, 1, HEIGHT, WIDTH),
        orientation=torch.zeros(1, 6, HEIGHT, WIDTH),
        log_size=None,
    )
    frame, row, column = object_cells(batch, empty)
    cell = torch.stack([column, row], -1) + 0.5
    empty.heat[frame, :, row, column] = 20
    empty.extent[frame, :, row, column] = (boxes_px[:, 2:] - boxes_px[:, :2]) / STRIDE
    empty.to_middle[frame, :, row, column] = (boxes_px[:, :2] + boxes_px[:, 2:]) / (2 * STRIDE) - cell
    empty.to_center[frame, :, row, column] = parameters.center_px / STRIDE - cell
    empty.depth[frame, :, row, column] = parameters.depth_m.log()[:, None]
    empty.orientation[frame, :, row, column] = parameters.orientation.flatten(1)
    return empty


def test_peaks_are_the_objects() -> None:
    batch = _batch()
    peaks = find_peaks(_perfect_maps(batch))
    assert (peaks.score > 0.5).sum() == 3
    order = peaks.boxes_px[:3, 0].argsort()
    expected = batch.objects.boxes_px[:, 0].argsort()
    torch.testing.assert_close(
        peaks.boxes_px[:3][order], batch.objects.boxes_px[expected], atol=1e-3, rtol=1e-4
    )
    for found, drawn in zip(peaks.parameters, perfect(batch.objects), strict=True):
        torch.testing.assert_close(found[:3][order], drawn[expected], atol=1e-2, rtol=1e-3)


def test_perfect_maps_cost_next_to_nothing() -> None:
    batch = _batch()
    terms = detection_loss(_perfect_maps(batch), batch, 1.0)
    assert terms["extent"] < 1e-4
    assert terms["middle"] < 1e-4
    # The bells around the peaks are cold in these maps, which costs nothing: they are no objects.
    assert terms["heat"] < 1e-4


def test_heat_is_one_at_the_objects_and_falls_with_the_box() -> None:
    batch = _batch()
    maps = _perfect_maps(batch)
    heat = target_heat(batch, maps)
    frame, row, column = object_cells(batch, maps)
    assert (heat[frame, 0, row, column] == 1).all()
    assert (heat == 1).sum() == 3
    wide = int((batch.objects.boxes_px[:, 2] - batch.objects.boxes_px[:, 0]).argmax())
    assert heat[0, 0, row[wide], column[wide] + 1] > heat[0, 0, row[wide] + 1, column[wide]]


def test_no_objects_only_cool_the_heat() -> None:
    batch = _batch()
    none = {name: getattr(batch.objects, name)[:0] for name in batch.objects.__dataclass_fields__}
    empty = replace(batch, object_counts=[0], objects=type(batch.objects)(**none))
    terms = detection_loss(_perfect_maps(batch), empty, 1.0)
    assert terms["extent"] == terms["middle"] == 0
    assert terms["heat"] > 1


@pytest.mark.parametrize(("backbone", "sizes"), [("nanodet", "frozen"), ("resnet18", "learned")])
def test_exports(backbone: str, sizes: str) -> None:
    class Detected(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.network = CenterNetwork(
                ModelSettings.model_validate({"backbone": backbone, "sizes": sizes, "hidden": 8}), classes=2
            )

        def forward(self, image: Tensor) -> tuple[Tensor, ...]:
            peaks = find_peaks(self.network(padded(image)))
            return peaks.score, peaks.boxes_px, *peaks.parameters

    torch.manual_seed(0)
    module = Detected().eval()
    calls = [(torch.rand(1, 3, 60, 90) * 255,), (torch.rand(1, 3, 96, 160) * 255,)]
    for call, exported in zip(
        calls, run_exported(module, calls[0], [{2: "height", 3: "width"}], *calls), strict=True
    ):
        with torch.no_grad():
            expected = module(*call)
        torch.testing.assert_close(expected[0], exported[0], atol=1e-4, rtol=1e-3)


def test_parameters_come_from_the_cell_of_their_frame() -> None:
    batch = _batch()
    maps = _perfect_maps(batch)
    blank = {name: torch.zeros_like(level) for name, level in maps._asdict().items() if level is not None}
    two = DenseMaps(
        log_size=None, **{name: torch.cat([level, getattr(maps, name)]) for name, level in blank.items()}
    )
    _, row, column = object_cells(batch, maps)
    found = parameters_at(two, torch.ones_like(row), row, column)
    torch.testing.assert_close(found.depth_m, perfect(batch.objects).depth_m)
