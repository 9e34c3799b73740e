"""A label set that is being written, watched: its newest frame as a picture, again and again."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from boxlift.errors import DatasetError, InputError
from boxlift_client.pictures import draw_labels_on_disk, write_picture

_PAUSE_S = 0.5


def watch_label_set(
    source: Path, labels: Path, out: Path, gt: str | None, on_drawn: Callable[[str], None]
) -> None:
    """Draw the frame of `labels` that was written last into `out`, whenever there is a newer one.

    Does not end by itself. on_drawn: called with the name of each frame that was drawn. One that cannot be
    drawn is passed over; the picture is replaced whole. Raises DatasetError where there is no label set.
    """
    data = labels / "data"
    if not data.is_dir():
        raise DatasetError(
            str(labels), "the folder is no label set yet.", "Start `boxlift label --out` first."
        )
    drawn = ""
    hidden = out.with_name(f".{out.stem}.tmp{out.suffix}")
    while True:
        name = _newest(data)
        if name is not None and name != drawn:
            drawn = name
            try:
                write_picture(hidden, draw_labels_on_disk(source, name, labels, gt))
            except InputError as error:
                on_drawn(f"{name}: {error}")
            else:
                hidden.replace(out)
                on_drawn(name)
        time.sleep(_PAUSE_S)


def _newest(data: Path) -> str | None:
    """The frame whose labels were written last; None without any."""
    files = [path for path in data.iterdir() if path.suffix == ".txt" and not path.name.startswith(".")]
    newest = max(files, key=lambda path: (path.stat().st_mtime_ns, path.name), default=None)
    return None if newest is None else newest.stem
