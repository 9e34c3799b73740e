from __future__ import annotations

from collections.abc import Sequence
from random import Random

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from boxlift.network.detections import CLASSES, COCO_INDICES, Detections, RoadUsers
from boxlift.network.nanodet import NanoDetHead, NanoDetTrunk, RawDetections

Box = tuple[float, float, float, float]
Cell = tuple[str, Box, float]
NAMES = list(COCO_INDICES)


def _found(cells: Sequence[Cell], min_score: float = 0.1, size: tuple[int, int] = (400, 200)) -> Detections:
    """What RoadUsers makes of cells that each hold one COCO class, in an image of this width and height."""
    scores = torch.zeros(1, len(cells), len(NAMES))
    boxes = torch.zeros(1, len(cells), 4)
    for row, (name, box, score) in enumerate(cells):
        scores[0, row, NAMES.index(name)] = score
        boxes[0, row] = torch.tensor(box)
    width, height = (torch.tensor(float(side)) for side in size)
    found: Detections = RoadUsers(min_score)(RawDetections(scores, boxes), width, height)
    return found


def _named(found: Detections) -> list[tuple[str, list[float]]]:
    return [
        (CLASSES[kind], box)
        for kind, box in zip(found.categories.tolist(), found.boxes_px.tolist(), strict=True)
    ]


def _area(box: Box) -> float:
    return (box[2] - box[0]) * (box[3] - box[1])


def _shared(one: Box, other: Box) -> float:
    across = min(one[2], other[2]) - max(one[0], other[0])
    down = min(one[3], other[3]) - max(one[1], other[1])
    return max(0.0, across) * max(0.0, down)


def _plainly_kept(cells: Sequence[Cell]) -> list[int]:
    """Greedy suppression as a loop, best first: vehicles suppress vehicles, persons persons."""
    kept: list[int] = []
    for row in sorted(range(len(cells)), key=lambda row: -cells[row][2]):
        name, box, _ = cells[row]
        falls = False
        for better in kept:
            if (cells[better][0] == "person") != (name == "person"):
                continue
            shared = _shared(box, cells[better][1])
            iou = shared / (_area(box) + _area(cells[better][1]) - shared)
            falls |= iou > 0.6 or (name != "person" and shared / _area(box) > 0.8)
        if not falls:
            kept.append(row)
    return kept


boxes = st.builds(
    lambda x, y, width, height: (float(x), float(y), float(x + width), float(y + height)),
    st.integers(0, 30),
    st.integers(0, 15),
    st.integers(1, 40),
    st.integers(1, 20),
)


@settings(deadline=None, max_examples=150)
@given(
    st.lists(st.tuples(st.sampled_from(["car", "truck", "bus", "person"]), boxes), max_size=12),
    st.randoms(use_true_random=False),
)
def test_suppression_is_greedy(drawn: list[tuple[str, Box]], random: Random) -> None:
    scores = [0.2 + 0.05 * place for place in range(len(drawn))]
    random.shuffle(scores)
    cells = [(name, box, score) for (name, box), score in zip(drawn, scores, strict=True)]
    found = _found(cells)
    expected = [cells[row] for row in _plainly_kept(cells)]
    # Areas are whole numbers, so that both sides decide alike on a limit, too.
    assert found.boxes_px.tolist() == [list(box) for _, box, _ in expected]
    assert found.scores.tolist() == pytest.approx([score for _, _, score in expected])


def test_long_chains_are_followed() -> None:
    """Each box suppresses the next one only: every second stays."""
    cells: list[Cell] = [
        ("car", (20.0 * step, 50.0, 20.0 * step + 100, 100.0), 0.9 - 0.05 * step) for step in range(14)
    ]
    assert [box[0] for _, box in _named(_found(cells))] == [40.0 * step for step in range(7)]


def test_vehicles_inside_vehicles_go() -> None:
    """A window or wheel that passes for a car, though its IoU is small, and also inside a truck."""
    part = ("car", (150.0, 70.0, 190.0, 110.0), 0.5)
    assert _named(_found([("car", (100, 50, 220, 120), 0.9), part])) == [("Car", [100, 50, 220, 120])]
    assert _named(_found([("bus", (100, 50, 220, 120), 0.9), part])) == [("Truck", [100, 50, 220, 120])]
    # The surer one stays: a car before a truck hides part of it.
    surer = ("car", part[1], 0.95)
    assert {name for name, _ in _named(_found([("truck", (100, 50, 220, 120), 0.9), surer]))} == {
        "Car",
        "Truck",
    }


def test_persons_before_vehicles_stay() -> None:
    found = _found([("car", (100, 50, 220, 120), 0.9), ("person", (150, 55, 170, 115), 0.4)])
    assert _named(found) == [("Car", [100, 50, 220, 120]), ("Pedestrian", [150, 55, 170, 115])]


def test_surest_class_of_a_cell_counts() -> None:
    scores = torch.zeros(1, 1, len(NAMES))
    scores[0, 0] = torch.tensor([0.3, 0.2, 0.6, 0.5, 0.1, 0.1])
    box = torch.tensor([[[10.0, 20, 50, 60]]])
    found = RoadUsers()(RawDetections(scores, box), torch.tensor(400.0), torch.tensor(200.0))
    assert [CLASSES[kind] for kind in found.categories.tolist()] == ["Truck"]
    assert found.scores.tolist() == pytest.approx([0.6])


@pytest.mark.parametrize("cycle", ["bicycle", "motorcycle"])
def test_person_over_a_cycle_is_a_cyclist(cycle: str) -> None:
    found = _found([("person", (100, 40, 130, 110), 0.8), (cycle, (90, 80, 150, 130), 0.6)])
    assert _named(found) == [("Cyclist", [90, 40, 150, 130])]
    assert found.scores.tolist() == pytest.approx([0.8])


@pytest.mark.parametrize(
    "person",
    [
        pytest.param((160, 40, 190, 125), id="beside"),
        pytest.param((138, 40, 168, 125), id="beside, overlapping"),
        pytest.param((100, 60, 130, 170), id="in front"),
        pytest.param((100, 20, 130, 75), id="behind"),
    ],
)
def test_person_by_a_parked_bicycle_is_a_pedestrian(person: Box) -> None:
    found = _found([("person", person, 0.8), ("bicycle", (90, 80, 150, 130), 0.6)])
    assert _named(found) == [("Pedestrian", list(person))]


def test_each_rider_takes_its_own_bicycle() -> None:
    found = _found(
        [
            ("person", (100, 40, 130, 110), 0.8),
            ("bicycle", (90, 80, 150, 130), 0.6),
            ("person", (300, 40, 330, 110), 0.7),
            ("bicycle", (290, 80, 350, 130), 0.5),
            ("person", (200, 40, 230, 110), 0.6),
        ]
    )
    assert _named(found) == [
        ("Cyclist", [90, 40, 150, 130]),
        ("Cyclist", [290, 40, 350, 130]),
        ("Pedestrian", [200, 40, 230, 110]),
    ]


@pytest.mark.parametrize("cycle", ["bicycle", "motorcycle"])
def test_lone_cycles_vanish(cycle: str) -> None:
    assert _named(_found([(cycle, (90, 80, 150, 130), 0.9), ("car", (200, 80, 300, 130), 0.5)])) == [
        ("Car", [200, 80, 300, 130])
    ]


def test_boxes_are_cut_at_the_border() -> None:
    (found,) = _named(_found([("car", (-30, 100, 90, 250), 0.9)]))
    assert found == ("Car", [0, 100, 90, 200])


@pytest.mark.parametrize("cells", [[], [("car", (10.0, 10.0, 50.0, 50.0), 0.05)]])
def test_nothing_is_found(cells: list[Cell]) -> None:
    found = _found(cells)
    assert (found.boxes_px.shape, found.scores.shape, found.categories.shape) == ((0, 4), (0,), (0,))
    assert found.categories.dtype == torch.int64
    # Nor does a score of nothing count, whatever is asked for.
    assert len(_found([("car", (10, 10, 50, 50), 0.0)], min_score=0.0).scores) == 0


@pytest.mark.parametrize("side", [1, 31, 32, 64])
def test_tiny_images(side: int) -> None:
    """Fewer cells than candidates, from a real head with random weights."""
    torch.manual_seed(0)
    padded = side + -side % 32
    raw = NanoDetHead(len(NAMES))(NanoDetTrunk()(torch.rand(1, 3, padded, padded) * 255))
    assert raw.scores.shape[1] == sum((padded // stride) ** 2 for stride in (8, 16, 32))
    found = RoadUsers(0.0)(raw, torch.tensor(float(side)), torch.tensor(float(side)))
    assert (found.boxes_px >= 0).all()
    assert (found.boxes_px <= side).all()
    assert (found.scores.diff() <= 0).all()
