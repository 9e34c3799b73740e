"""One real service for all tests, with limits that tests can reach."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from service.frames import SmallFrame, small_frame
from service.running import RunningService, running_service


@pytest.fixture(scope="session")
def service() -> Iterator[RunningService]:
    """The service on a free port, ready."""
    with running_service(max_points="100000", max_prompts="50", max_image_pixels="4000000") as running:
        yield running


@pytest.fixture(scope="session")
def frame() -> SmallFrame:
    """A small frame with one car."""
    return small_frame()
