"""Where files are: a folder here, or a bucket elsewhere, told by the name alone.

Paths here stay pathlib's; whatever names a protocol (`s3://bucket/folder`) becomes a UPath of
universal-pathlib, which speaks fsspec. Both have the same methods, so that readers and writers need not know.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from upath import UPath

    AnyPath: TypeAlias = Path | UPath
