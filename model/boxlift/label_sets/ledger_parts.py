"""The parts of a label set's ledger, as they are read: which data set each frame is of.

`boxlift label` appends to the ledger and says what became of frames; its module has the columns.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from boxlift.errors import LabelFormatError, MissingExtraError
from boxlift.storage import is_folder, names_in, read_whole

if TYPE_CHECKING:
    from boxlift.storage import AnyPath

# The ledger's folder in a label set.
LEDGER = "ledger"


def read_frame_sources(folder: AnyPath) -> dict[str, str]:
    """The id of every frame's data set. Raises LabelFormatError where a part cannot be read."""
    return {
        frame: source
        for table in ledger_tables(folder, ["frame", "source"])
        for frame, source in zip(table["frame"].to_pylist(), table["source"].to_pylist(), strict=True)
    }


def ledger_tables(folder: AnyPath, columns: list[str]) -> Iterator[Any]:
    """The columns of every part. Raises LabelFormatError where a part cannot be read."""
    if not is_folder(folder):
        return
    _, parquet = pyarrow_modules()
    for name in sorted(names_in(folder)):
        if name.startswith(".") or not name.endswith(".parquet"):
            continue
        path = folder / name
        try:
            yield parquet.read_table(io.BytesIO(read_whole(path)), columns=columns, use_threads=False)
        except (OSError, ValueError, KeyError) as error:
            problem = f"the part of the ledger cannot be read ({str(error).splitlines()[0]:.200})."
            remedy = "Delete it: the frames in it are labelled again."
            raise LabelFormatError(str(path), problem, remedy) from None


def pyarrow_modules() -> tuple[Any, Any]:
    """pyarrow and pyarrow.parquet. Raises MissingExtraError."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise MissingExtraError("pyarrow", "client") from None
    return pyarrow, pyarrow.parquet
