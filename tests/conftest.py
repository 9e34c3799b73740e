"""Where real frames and recorded values lie, when they lie anywhere: beside the checkout, optional."""

from __future__ import annotations

from pathlib import Path

import pytest

_SHARED = Path(__file__).resolve().parents[2] / "shared"
_KITTI_OBJECT = _SHARED / "kitti" / "object"
_KITTI_SEQUENCES = _SHARED / "kitti" / "sequences"
_ORACLE = _SHARED / "oracle"


# Debian's.
CHROMIUM = Path("/usr/bin/chromium")


@pytest.fixture(scope="session")
def kitti_object_root() -> Path:
    """Root of real frames in KITTI object layout (the folder that holds training/)."""
    if not (_KITTI_OBJECT / "training").is_dir():
        pytest.skip("no real frames in ../shared/kitti/object")
    return _KITTI_OBJECT


@pytest.fixture(scope="session")
def kitti_sequences_root() -> Path:
    """Folder of real drives; their frames are in object/ and weak/ beside it."""
    if not _KITTI_SEQUENCES.is_dir():
        pytest.skip("no real drives in ../shared/kitti/sequences")
    return _KITTI_SEQUENCES


@pytest.fixture(scope="session")
def oracle_root() -> Path:
    """Folder with the values that other implementations gave."""
    if not _ORACLE.is_dir():
        pytest.skip("no recorded values in ../shared/oracle")
    return _ORACLE


@pytest.fixture(scope="session")
def chromium() -> Path:
    """The browser."""
    if not CHROMIUM.is_file():
        pytest.skip("no Chromium")
    return CHROMIUM


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say once that tests on real frames did not run."""
    missing = [
        f"../shared/{path.relative_to(_SHARED)}"
        for path in (_KITTI_OBJECT, _KITTI_SEQUENCES, _ORACLE)
        if not path.is_dir()
    ]
    if not CHROMIUM.is_file():
        terminalreporter.write_line(
            f"Not there, so the tests of the review page in a browser were skipped: {CHROMIUM}"
        )
    if missing:
        terminalreporter.write_line(
            f"Not there, so the tests that need them were skipped: {', '.join(missing)}"
        )
