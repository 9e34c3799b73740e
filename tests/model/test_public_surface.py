"""What `import boxlift` gives, and what it does not load."""

from __future__ import annotations

import subprocess
import sys

import boxlift


def test_names() -> None:
    assert sorted(boxlift.__all__) == boxlift.__all__
    assert all(hasattr(boxlift, name) for name in boxlift.__all__)


def test_importing_boxlift_is_light() -> None:
    heavy = "torch", "open3d", "PIL", "fastapi", "onnxruntime", "httpx"
    code = f"import boxlift, sys; print([name for name in {heavy!r} if name in sys.modules])"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"


def test_errors_name_field_problem_and_remedy() -> None:
    error = boxlift.InputError("points", "the file is empty.", "Send a point cloud.")
    assert str(error) == "points: the file is empty. Send a point cloud."
    assert isinstance(error, boxlift.BoxliftError)


def test_a_missing_extra_names_itself() -> None:
    code = """
import sys
sys.modules["open3d"] = None
import boxlift.extras
try:
    boxlift.extras.open3d()
except boxlift.MissingExtraError as error:
    print(error)
"""
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "pip install 'boxlift[label]'" in answer.stdout
