"""A service with a folder for dropped frames."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from service.running import RunningService, running_service


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the label sets are."""
    return tmp_path_factory.mktemp("review") / "labels"


@pytest.fixture(scope="module")
def reviewed(folder: Path) -> Iterator[RunningService]:
    """The service that opens them."""
    with running_service(label_sets=str(folder)) as running:
        yield running
