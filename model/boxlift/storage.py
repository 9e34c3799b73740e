"""Where files are: a folder here, or a bucket elsewhere, told by the name alone.

Paths here stay pathlib's; whatever names a protocol (`s3://bucket/folder`) becomes a UPath of
universal-pathlib, which speaks fsspec. Both have the same methods, so that readers and writers need not know.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, TypeAlias

from boxlift.errors import InputError, MissingExtraError, OptionsError

if TYPE_CHECKING:
    from upath import UPath

    AnyPath: TypeAlias = Path | UPath

_S3 = ("s3", "s3a")


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
        # Without a cache of listings, for other machines write meanwhile.
        path = UPath(name, use_listings_cache=False)
        # Asked here, so that what is missing, a library or a right, is told before anything starts.
        with suppress(FileNotFoundError):
            path.fs.info(path.path)
    except ImportError as error:
        if protocol in _S3:
            raise MissingExtraError("s3fs", "s3") from None
        raise OptionsError("path", f"{name!r} needs a library.", f"{error}") from None
    except ValueError as error:
        raise OptionsError(
            "path", f"{name!r} names a protocol that is not known ({error}).", "Give a folder, or s3://..."
        ) from None
    except Exception as error:  # each library has errors of its own
        raise OptionsError(
            "path",
            f"{name!r} cannot be reached ({type(error).__name__}: {error!s:.200}).",
            "Check bucket, endpoint and credentials (for S3 the variables AWS_*).",
        ) from None
    return path


def is_folder(path: AnyPath) -> bool:
    """Whether there is a folder; in an object store, whether any name begins so.

    There `path.is_dir()` would list all that is in it, a thousand names a request.
    """
    if isinstance(path, Path):
        return path.is_dir()
    try:
        return bool(path.fs.info(path.path)["type"] == "directory")
    except FileNotFoundError:
        return False


def names_in(folder: AnyPath) -> list[str]:
    """Names of what is in a folder, in no order; in an object store by one listing. Raises OSError."""
    if isinstance(folder, Path):
        with os.scandir(folder) as entries:
            return [entry.name for entry in entries]
    return [str(name).rstrip("/").rpartition("/")[2] for name in folder.fs.ls(folder.path, detail=False)]


def read_whole(path: AnyPath) -> bytes:
    """The bytes of a file; in an object store by one request. Raises OSError."""
    if isinstance(path, Path):
        return path.read_bytes()
    # s3fs would ask for the size first, to fetch large files in parts.
    options = {"max_concurrency": 1} if path.protocol in _S3 else {}
    data = path.fs.cat_file(path.path, **options)
    assert isinstance(data, bytes)
    return data


def read_input(path: AnyPath, error_type: type[InputError]) -> bytes:
    """read_whole for a file that somebody gave. Raises `error_type` where it cannot be read."""
    try:
        return read_whole(path)
    except OSError as error:
        problem = f"the file cannot be read ({error.strerror or error})."
        raise error_type(str(path), problem, "Check the path.") from None


@contextmanager
def writing_whole(path: AnyPath) -> Iterator[BinaryIO]:
    """A file to be written bit by bit, there when the block ends well: until then readers see the old one.

    In an object store what was written is put as one object. Raises OSError.
    """
    if not isinstance(path, Path):
        with tempfile.TemporaryFile() as file:
            yield file
            file.seek(0)
            with path.open("wb") as there:
                shutil.copyfileobj(file, there)
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = _beside(path)
    try:
        with beside.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
    except BaseException:
        beside.unlink(missing_ok=True)
        raise


def write_whole(path: AnyPath, data: bytes) -> None:
    """Write a file so that a reader, or a crash, sees the old one or the new one, and nothing between.

    Here: written beside, flushed to disk, renamed. In an object store: one put. Raises OSError.
    """
    if not isinstance(path, Path):
        path.write_bytes(data)
        return
    with writing_whole(path) as file:
        file.write(data)


def _beside(path: Path) -> Path:
    return path.with_name(f".{path.name}.{os.getpid()}-{threading.get_ident()}.tmp")
