"""docs/detectors.md: its example runs as it stands there, and wraps a model that takes a square image."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import parser

from boxlift import Prompt
from boxlift.detector import Detector

_DOCS = Path(__file__).resolve().parents[3] / "docs" / "detectors.md"

# A model of YOLO's kind, of an older opset, whose classes are those of the example: a Car (0.9) around the
# bright pixels, once more (0.8) nearly there, and a Cyclist (0.2) somewhere else.
_THEIRS = """<ir_version: 8, opset_import: ["": 13]>
theirs (float[1, 3, 640, 640] images) => (float[1, 7, 3] output0) {
    zero = Constant <value = int64[1] {0}> ()
    one = Constant <value = int64[1] {1}> ()
    axes = Constant <value = int64[2] {0, 1}> ()
    red_planes = Slice (images, zero, one, one)
    red = Squeeze (red_planes, axes)
    limit = Constant <value = float {0.9}> ()
    bright = Greater (red, limit)
    places = NonZero (bright)
    places_f = Cast <to = 1> (places)
    low = ReduceMin <axes = [1], keepdims = 0> (places_f)
    last = ReduceMax <axes = [1], keepdims = 0> (places_f)
    unit = Constant <value = float {1.0}> ()
    high = Add (last, unit)
    swap = Constant <value = int64[2] {1, 0}> ()
    low_xy = Gather (low, swap)
    high_xy = Gather (high, swap)
    sum = Add (low_xy, high_xy)
    half = Constant <value = float {0.5}> ()
    center = Mul (sum, half)
    size = Sub (high_xy, low_xy)
    box = Concat <axis = 0> (center, size)
    shift = Constant <value = float[4] {1.0, 0.0, 0.0, 0.0}> ()
    nearly = Add (box, shift)
    other = Constant <value = float[4] {600.0, 10.0, 20.0, 10.0}> ()
    three = Concat <axis = 0> (box, nearly, other)
    shape = Constant <value = int64[2] {3, 4}> ()
    rows = Reshape (three, shape)
    columns = Transpose <perm = [1, 0]> (rows)
    scores = Constant <value = float[3, 3] {0.0, 0.0, 0.0, 0.0, 0.0, 0.2, 0.9, 0.8, 0.0}> ()
    joined = Concat <axis = 0> (columns, scores)
    output0 = Unsqueeze (joined, zero)
}"""


def test_the_example_wraps_a_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", _DOCS.read_text(), re.DOTALL)
    monkeypatch.chdir(tmp_path)
    onnx.save(parser.parse_model(_THEIRS), "theirs.onnx")
    exec(compile(code, str(_DOCS), "exec"), {})

    detector = Detector.open(tmp_path / "mine.onnx")
    assert detector.class_names == ("Pedestrian", "Cyclist", "Car")
    for width, height, box in ((1280, 384, (100, 200, 300, 320)), (480, 960, (96, 150, 300, 900))):
        image = np.full((height, width, 3), 60, np.uint8)
        x1, y1, x2, y2 = box
        image[y1:y2, x1:x2] = 255
        (prompt,) = detector.detect(image).prompts
        assert (prompt.category, prompt.score) == ("Car", 0.9)
        np.testing.assert_allclose(prompt.box_px, box, atol=2)
    # Suppression leaves one of two on the same object; a lower threshold shows the third.
    image = np.full((640, 640, 3), 255, np.uint8)
    assert detector.detect(image, min_score=0.15).prompts[1:] == (
        Prompt("Cyclist", (590.0, 5.0, 610.0, 15.0), 0.2),
    )
