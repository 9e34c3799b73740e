from __future__ import annotations

import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from boxlift.boxes import Boxes3D
from boxlift.errors import LabelFormatError
from boxlift.formats import kitti_label
from boxlift.formats.details import FrameDetails, details_of, parse_text
from boxlift.frame import FrameLabels, ObjectLabel, Prompt, Result
from boxlift.label_sets.files import data_path, details_path, read_objects, write_label_files


def car_details(name: str = "a frame", sentence: str = "A box was fitted.") -> FrameDetails:
    box = Boxes3D(
        center_cam=np.array([[1.234, 1.5, 20.5]]),
        length_m=np.array([4.0]),
        width_m=np.array([1.6]),
        height_m=np.array([1.8]),
        rotation_y=np.array([-0.001]),
    )
    fitted = ObjectLabel(
        0, Prompt("Car", (10.0, 20.0, 30.004, 40.0), 0.5), Result.FITTED, sentence, box, 0.75
    )
    refused = ObjectLabel(1, Prompt("Tram", (1.0, 2.0, 3.0, 4.0)), Result.UNKNOWN_CLASS, "Unknown.")
    return details_of(FrameLabels(name, (fitted, refused)))


def test_two_files_that_read_back(tmp_path: Path) -> None:
    details = car_details()
    out = tmp_path / "not" / "there" / "yet"
    write_label_files(out, "a frame", details)
    assert data_path(out, "a frame") == out / "data" / "a frame.txt"
    assert (out / "data" / "a frame.txt").read_text() == (
        "Car -1 -1 -0.06 10.00 20.00 30.00 40.00 1.80 1.60 4.00 1.23 2.40 20.50 0.00 0.7500\n"
    )
    assert parse_text((out / "details" / "a frame.json").read_text()) == details
    (line,) = kitti_label.read_file(data_path(out, "a frame"))
    car, tram = read_objects(details_path(out, "a frame"))
    assert car == line
    assert (tram.category, tram.box_px, tram.has_box3d) == ("Tram", (1, 2, 3, 4), False)
    (out / "details" / "a frame.json").write_text("{}")
    with pytest.raises(LabelFormatError, match="no details of boxlift"):
        read_objects(details_path(out, "a frame"))


def test_no_objects_is_an_empty_file(tmp_path: Path) -> None:
    write_label_files(tmp_path, "empty", FrameDetails(frame="empty", objects=()))
    assert data_path(tmp_path, "empty").read_bytes() == b""
    assert details_path(tmp_path, "empty").is_file()


def test_a_write_that_fails_leaves_the_old_files_and_nothing_else(tmp_path: Path) -> None:
    write_label_files(tmp_path, "a", car_details())
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    with _full_disk(), pytest.raises(OSError, match="File too large"):
        write_label_files(tmp_path, "a", car_details(sentence="x" * 100_000))
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    (tmp_path / "data" / "b.txt").mkdir()
    with pytest.raises(OSError, match=r"b\.txt"):
        write_label_files(tmp_path, "b", car_details())
    assert not [path for path in tmp_path.rglob("*") if path.suffix == ".tmp"]


def test_new_labels_replace_old_ones(tmp_path: Path) -> None:
    write_label_files(tmp_path, "a", car_details())
    write_label_files(tmp_path, "a", FrameDetails(frame="a", objects=()))
    assert data_path(tmp_path, "a").read_bytes() == b""


@contextmanager
def _full_disk() -> Iterator[None]:
    """No file of this process may grow beyond 4 KiB."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
