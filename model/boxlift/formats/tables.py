"""Feather and Parquet files as columns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from boxlift.errors import LabelFormatError, MissingExtraError
from boxlift.storage import read_whole

if TYPE_CHECKING:
    from boxlift.storage import AnyPath

SUFFIXES = (".feather", ".parquet")


def read_columns(path: AnyPath, names: Sequence[str] | None = None) -> dict[str, list[Any]]:
    """All columns, or `names`, as lists. Raises as read_table."""
    columns: dict[str, list[Any]] = read_table(path, names).to_pydict()
    return columns


def read_table(path: AnyPath, names: Sequence[str] | None = None, filters: Any = None) -> Any:
    """A pyarrow.Table of all columns, or of `names`; filters: pyarrow's, of Parquet files alone.

    Of a Parquet file only what is asked for is read: it may be larger than memory.
    Raises LabelFormatError, MissingExtraError without pyarrow, OSError.
    """
    try:
        import pyarrow
        from pyarrow import feather, parquet
    except ImportError:
        raise MissingExtraError("pyarrow", "client") from None
    chosen = None if names is None else list(names)
    with path.open("rb") if path.suffix == ".parquet" else pyarrow.BufferReader(read_whole(path)) as file:
        try:
            if path.suffix == ".parquet":
                return parquet.read_table(file, columns=chosen, filters=filters)
            return feather.read_table(file, columns=chosen)
        except (pyarrow.ArrowException, OSError, KeyError) as error:
            raise LabelFormatError(
                str(path), f"the file is no table ({str(error)[:200]}).", "Give a Feather or Parquet file."
            ) from None
