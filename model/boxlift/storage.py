"""Where files are: a folder here, or a bucket elsewhere, told by the name alone.

Paths here stay pathlib's; whatever names a protocol (`s3://bucket/folder`) becomes a UPath of
universal-pathlib, which speaks fsspec. Both have the same methods, so that readers and writers need not know.
"""

from __future__ import annotations

import os
import threading
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from boxlift.errors import MissingExtraError, OptionsError

if TYPE_CHECKING:
    from upath import UPath

    AnyPath: TypeAlias = Path | UPath

_EXTRAS = {"s3": "s3", "s3a": "s3"}


def open_path(name: str) -> AnyPath:
    """The path that `name` says: one of this machine, or `PROTOCOL://...` through fsspec.

    Raises OptionsError where the protocol is not known, MissingExtraError where its library is missing.
    """
    protocol, separator, _ = name.partition("://")
    if not separator:
        return Path(name)
    if protocol == "file":
        return Path(name.removeprefix("file://"))
    try:
        from upath import UPath
    except ImportError:
        raise MissingExtraError("universal_pathlib", "client") from None
    try:
        path = UPath(name)
        # Made here, so that a library that is missing is told before anything starts.
        _ = path.fs
    except ImportError as error:
        raise MissingExtraError(str(error.name or protocol), _EXTRAS.get(protocol, protocol)) from None
    except ValueError as error:
        raise OptionsError(
            "path", f"{name!r} names a protocol that is not known ({error}).", "Give a folder, or s3://..."
        ) from None
    return path


def write_whole(path: AnyPath, data: bytes) -> None:
    """Write a file so that a reader, or a crash, sees the old one or the new one, and nothing between.

    Here: written beside, flushed to disk, renamed. In an object store: one put. Raises OSError.
    """
    if not isinstance(path, Path):
        path.write_bytes(data)
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{path.name}.{os.getpid()}-{threading.get_ident()}.tmp")
    try:
        with beside.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
    except BaseException:
        beside.unlink(missing_ok=True)
        raise
