"""Numbers as lines of text, as .pcd and .ply hold them when they are ascii."""

from __future__ import annotations

import io
from collections.abc import Iterator
from itertools import chain, islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

_LONGEST_LINE_BYTES = 65_536


def read_number_lines(body: bytes, count: int, columns: list[int]) -> NDArray[Any]:
    """The first `count` lines that are not blank -> float64 (lines found, len(columns)).

    Raises ValueError where a line is too long, has too few numbers or something else.
    """
    lines = islice(_lines(body), count)
    first = next(lines, None)
    if first is None:
        return np.empty((0, len(columns)))
    return np.loadtxt(chain((first,), lines), np.float64, comments=None, usecols=columns, ndmin=2)


def _lines(body: bytes) -> Iterator[bytes]:
    for line in io.BytesIO(body):
        if len(line) > _LONGEST_LINE_BYTES:
            raise ValueError(f"a line has {len(line)} bytes")
        if not line.isspace():
            yield line
