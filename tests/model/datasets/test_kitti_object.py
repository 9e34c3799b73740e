"""KITTI object layout: generated here, and real where it is there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from boxlift import Calibration
from boxlift.datasets import load_prompts, open_source
from boxlift.errors import DatasetError
from boxlift.formats.calibration import to_kitti_text


def write_split(split: Path, names: list[str]) -> None:
    for folder in ("velodyne", "calib", "image_2", "label_2"):
        (split / folder).mkdir(parents=True)
    projection = np.array([[100.0, 0, 50, 0], [0, 100, 40, 0], [0, 0, 1, 0]])
    for name in names:
        (split / "velodyne" / f"{name}.bin").write_bytes(np.ones((5, 4), np.float32).tobytes())
        (split / "calib" / f"{name}.txt").write_text(to_kitti_text(Calibration(projection, np.eye(4))))
        Image.new("RGB", (64, 48)).save(split / "image_2" / f"{name}.png")
        (split / "label_2" / f"{name}.txt").write_text("")


def test_training_is_the_split_of_a_root(tmp_path: Path) -> None:
    write_split(tmp_path / "training", ["000001", "000000"])
    write_split(tmp_path / "testing", ["000009"])
    source = open_source(tmp_path)
    assert source.root == tmp_path / "training"
    assert source.names == ("000000", "000001")
    assert len(source.load("000001").points_velo) == 5
    assert load_prompts("label_2", source, "000001") == ()
    assert open_source(tmp_path / "testing").names == ("000009",)


def test_testing_where_there_is_no_training(tmp_path: Path) -> None:
    write_split(tmp_path / "testing", ["000009"])
    assert open_source(tmp_path).names == ("000009",)


def test_frame_without_points_is_named_and_explained(tmp_path: Path) -> None:
    write_split(tmp_path / "training", ["000000", "000001"])
    (tmp_path / "training" / "velodyne" / "000001.bin").unlink()
    (tmp_path / "training" / "image_2" / "000001.png").unlink()
    source = open_source(tmp_path)
    assert source.names == ("000000", "000001")
    with pytest.raises(DatasetError, match="'000001' has no LiDAR points"):
        source.load("000001")


def test_real_frames(kitti_object_root: Path) -> None:
    source = open_source(kitti_object_root)
    without_points = {"000023", "007091"}
    names = [name for name in source.names if name not in without_points]
    loaded = [source.load(name, load_prompts("label_2", source, name)) for name in names]
    assert (len(source.names), len(loaded)) == (45, 43)
    for name in without_points:
        with pytest.raises(DatasetError, match="no LiDAR points"):
            source.load(name)
    for frame in loaded:
        assert frame.points_velo.shape[1] == 4
        assert frame.image_size_px[0] in range(1220, 1250)
        assert all(prompt.category != "DontCare" for prompt in frame.prompts)
    assert all(load_prompts("det_2d", source, frame.name) for frame in loaded[:5])


def test_real_points_fall_on_the_labelled_cars(kitti_object_root: Path) -> None:
    """The calibration is read as KITTI means it: cars that are not hidden have points in their boxes."""
    source = open_source(kitti_object_root)
    frame = source.load("000007", load_prompts("label_2", source, "000007"))
    pixels, depth_m = frame.calibration.project(frame.calibration.velo_to_cam(frame.points_velo))
    x1, y1, x2, y2 = frame.prompts[0].box_px
    with np.errstate(invalid="ignore"):
        inside = (pixels >= (x1, y1)).all(axis=1) & (pixels <= (x2, y2)).all(axis=1)
    assert np.median(depth_m[inside]) == pytest.approx(25.01, abs=3)  # the label's z
