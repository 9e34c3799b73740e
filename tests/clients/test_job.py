"""What a frame is before it is labelled."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from boxlift.formats.calibration import parse_calibration
from boxlift_client.job import FrameStore, LabelJob

_BOX = (40.0, 100.0, 120.0, 200.0)


def test_boxes_drawn_on_an_image_with_distortion_are_rectified_with_it(tmp_path: Path) -> None:
    for part in ("velodyne", "calib", "image_2", "boxes"):
        (tmp_path / part).mkdir()
    (tmp_path / "velodyne" / "a.bin").write_bytes(np.ones((5, 4), np.float32).tobytes())
    values = {
        "P2": [[300, 0, 320, 0], [0, 310, 240, 0], [0, 0, 1, 0]],
        "cam_T_velo": [[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]],
        "distortion": [-0.3, 0.1, 0.001, -0.002, 0.01],
    }
    (tmp_path / "calib" / "a.json").write_text(json.dumps(values))
    Image.new("RGB", (640, 480)).save(tmp_path / "image_2" / "a.png")
    numbers = " ".join(str(edge) for edge in _BOX)
    (tmp_path / "boxes" / "a.txt").write_text(f"Car -1 -1 -10 {numbers} -1 -1 -1 -1000 -1000 -1000 -10\n")
    store = FrameStore(LabelJob(tmp_path, tmp_path / "out", prompts="boxes"))
    (prompt,) = store.load("a").given_frame.prompts
    lens = parse_calibration(json.dumps(values), with_lens=True).lens
    assert lens is not None
    assert prompt.box_px == pytest.approx(lens.rectified_box(_BOX, (640, 480)))
    assert prompt.box_px[0] < _BOX[0] - 5
