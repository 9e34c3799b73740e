"""One real service for all tests, with limits that tests can reach."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from model.stand_in_model import stand_in_model
from service.frames import SmallFrame, small_frame
from service.running import RunningService, running_service


@pytest.fixture(scope="session")
def model_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A monocular model that is made by hand."""
    return stand_in_model(tmp_path_factory.mktemp("model") / "hand_made.onnx")


@pytest.fixture(scope="session")
def service(model_path: Path) -> Iterator[RunningService]:
    """The service on a free port, ready, with the hand-made monocular model and the detector that ships."""
    limits = {"max_points": "100000", "max_prompts": "50", "max_image_pixels": "4000000", "max_images": "4"}
    with running_service(model=str(model_path), **limits) as running:
        yield running


@pytest.fixture(scope="session")
def frame() -> SmallFrame:
    """A small frame with one car."""
    return small_frame()
