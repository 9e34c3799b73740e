"""Writes what the code knows of docs/: pages from settings, commands, routes, results; pictures from frames.

make docs, or: PYTHONPATH=benchmarks python scripts/make_documentation.py [--out docs]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch

from documentation import (
    benchmarks_page,
    calibration_mistakes,
    commands_page,
    conventions_picture,
    http_page,
    method,
    settings_page,
)

_ROOMS = (
    benchmarks_page,
    calibration_mistakes,
    commands_page,
    conventions_picture,
    http_page,
    method,
    settings_page,
)


def main() -> None:
    """Write every file that is made."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parents[1] / "docs")
    out: Path = parser.parse_args().out
    torch.set_num_threads(1)
    for room in _ROOMS:
        for name, content in room.made().items():
            path = out / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content.encode() if isinstance(content, str) else content)


if __name__ == "__main__":
    main()
