"""KITTI label and result files: byte for byte, and the house's box in KITTI's conventions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boxlift import Boxes3D, FrameLabels, ObjectLabel, Prompt, Result
from boxlift.errors import LabelFormatError
from boxlift.formats import kitti_label

LABELS = (
    "Car 0.00 0 -1.55 614.24 181.78 727.31 284.77 1.57 1.73 4.15 1.00 1.75 13.22 -1.62\n"
    "Pedestrian 0.75 2 0.21 10.00 20.00 30.00 90.00 1.89 0.48 1.20 -1.00 -1.00 8.41 0.01\n"
    "DontCare -1 -1 -10 5.00 229.89 214.12 367.61 -1 -1 -1 -1000 -1000 -1000 -10\n"
)
RESULTS = (
    "Car -1 -1 -1.55 614.24 181.78 727.31 284.77 1.57 1.73 4.15 1.00 1.75 13.22 -1.62 0.9310\n"
    "Car -1 -1 -10 614.24 181.78 727.31 284.77 -1 -1 -1 -1000 -1000 -1000 -10 0.5000\n"
)


@pytest.mark.parametrize("text", ["", LABELS, RESULTS])
def test_text_round_trip(text: str) -> None:
    assert kitti_label.to_text(kitti_label.parse_text(text, "a.txt")) == text


def test_columns() -> None:
    car = kitti_label.parse_text(RESULTS, "a.txt")[0]
    assert car.category == "Car"
    assert (car.truncated, car.occluded, car.alpha) == (-1, -1, -1.55)
    assert car.box_px == (614.24, 181.78, 727.31, 284.77)
    assert car.size_hwl_m == (1.57, 1.73, 4.15)
    assert car.bottom_center_cam == (1.0, 1.75, 13.22)
    assert (car.rotation_y, car.score) == (-1.62, 0.931)


def test_placeholders_are_no_box() -> None:
    assert [label.has_box3d for label in kitti_label.parse_text(LABELS, "a.txt")] == [True, True, False]


def test_box_of_the_house_is_centred() -> None:
    boxes = kitti_label.boxes3d_of(kitti_label.parse_text(LABELS, "a.txt")[:1])
    np.testing.assert_allclose(boxes.center_cam, [[1.0, 1.75 - 1.57 / 2, 13.22]])
    assert (boxes.length_m[0], boxes.width_m[0], boxes.height_m[0]) == (4.15, 1.73, 1.57)
    assert boxes.rotation_y[0] == pytest.approx(-1.62)
    assert len(kitti_label.boxes3d_of([])) == 0


@given(
    st.tuples(st.floats(-50, 50), st.floats(-2, 3), st.floats(1, 90)),
    st.tuples(st.floats(0.3, 10), st.floats(0.3, 3), st.floats(0.3, 4)),
    st.floats(-4, 4),
)
def test_box_round_trip_within_the_decimals_of_the_file(
    center: tuple[float, float, float], size_lwh: tuple[float, float, float], rotation_y: float
) -> None:
    length, width, height = (np.array([side]) for side in size_lwh)
    box = Boxes3D(np.array([center]), length, width, height, np.array([rotation_y]))
    line = kitti_label.from_box3d("Car", (1, 2, 3, 4), box, 0.5).to_line()
    written = kitti_label.parse_line(line, "a.txt")
    again = kitti_label.boxes3d_of([written])
    np.testing.assert_allclose(again.center_cam, box.center_cam, atol=0.0101)
    np.testing.assert_allclose(again.length_m, box.length_m, atol=0.0051)
    turn = (again.rotation_y - box.rotation_y + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(turn, 0, atol=0.0051)
    # Alpha is rotation_y seen along the ray to the location, both as they stand in the line.
    x, _, z = written.bottom_center_cam
    difference = written.alpha - (written.rotation_y - np.arctan2(x, z))
    assert (difference + np.pi) % (2 * np.pi) - np.pi == pytest.approx(0, abs=0.0051)
    assert (written.truncated, written.occluded) == (-1, -1)


def test_labels_of_a_frame_keep_the_prompts_box() -> None:
    prompt = Prompt("Car", (1, 2, 3, 4), 0.8)
    box = Boxes3D(
        np.array([[0, 1, 10.0]]), np.array([4.0]), np.array([1.8]), np.array([1.6]), np.array([0.0])
    )
    fitted = ObjectLabel(1, prompt, Result.FITTED, "A box was fitted.", box, 0.25)
    refused = ObjectLabel(0, prompt, Result.TOO_FEW_POINTS, "Too few.")
    objects = kitti_label.objects_of(FrameLabels("f", (refused, fitted)))
    assert [label.to_line() for label in objects] == [
        "Car -1 -1 0.00 1.00 2.00 3.00 4.00 1.60 1.80 4.00 0.00 1.80 10.00 0.00 0.2500"
    ]


def test_prompts_leave_out_dont_care() -> None:
    prompts = kitti_label.prompts_of(kitti_label.parse_text(LABELS + RESULTS, "a.txt"))
    assert [(prompt.category, prompt.score) for prompt in prompts] == [
        ("Car", 1.0),
        ("Pedestrian", 1.0),
        ("Car", 0.931),
        ("Car", 0.5),
    ]


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("Car 1 2 3", "4 columns"),
        (LABELS.splitlines()[0] + " 0.5 7", "17 columns"),
        (LABELS.splitlines()[0].replace("13.22", "far"), "far"),
        (LABELS.splitlines()[0].replace("13.22", "nan"), "not finite"),
    ],
)
def test_malformed_lines_name_file_and_line(line: str, says: str) -> None:
    with pytest.raises(LabelFormatError) as caught:
        kitti_label.parse_text(f"{LABELS}\n{line}\n", "000007.txt")
    assert caught.value.field == "000007.txt:5"
    assert says in caught.value.problem


def test_file_that_is_no_text(tmp_path: Path) -> None:
    path = tmp_path / "label.txt"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(LabelFormatError, match="not text"):
        kitti_label.read_file(path)


def test_real_labels_byte_for_byte(kitti_object_root: Path) -> None:
    for path in sorted((kitti_object_root / "training" / "label_2").iterdir()):
        assert kitti_label.to_text(kitti_label.read_file(path)) == path.read_text()


def test_recorded_results_byte_for_byte(oracle_root: Path) -> None:
    for folder in ("label_2", "pred"):
        for path in sorted((oracle_root / "kitti_eval" / folder).iterdir())[:50]:
            assert kitti_label.to_text(kitti_label.read_file(path)) == path.read_text()
