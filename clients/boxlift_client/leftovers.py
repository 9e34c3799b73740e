"""What a run leaves beside its labels: the list of failed frames; and what earlier runs left, removed.

OUT/failed.csv      frame,attempts,sentence of every frame that has no labels; `--frames` reads it
"""

from __future__ import annotations

import csv
import io
from collections.abc import Container, Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from boxlift.storage import write_whole

if TYPE_CHECKING:
    from boxlift.storage import AnyPath
    from boxlift_client.ledger import LedgerState

FAILED = "failed.csv"


def write_failed(out: AnyPath, ledger: LedgerState) -> None:
    """Write OUT/failed.csv, or remove it where nothing failed."""
    path = out / FAILED
    if not ledger.failed:
        path.unlink(missing_ok=True)
        return
    text = io.StringIO()
    lines = csv.writer(text, lineterminator="\n")
    lines.writerow(("frame", "attempts", "sentence"))
    for frame, (attempts, sentence) in sorted(ledger.failed.items()):
        lines.writerow((frame, attempts, " ".join(sentence.split())))
    write_whole(path, text.getvalue().encode())


def remove_leftovers(
    out: AnyPath, done: Container[str], folders: Iterable[str] = ("data", "details")
) -> None:
    """Remove the temporary files of writers that were killed (a bucket has none).

    Only those of frames (or whatever the files of `folders` are of) that are done: nobody is writing these
    any more, while those of others may be another shard's.
    """
    if not isinstance(out, Path):
        return
    for folder in folders:
        for path in (out / folder).glob(".*.tmp"):
            # .STEM.txt.PID-THREAD.tmp, see boxlift.storage.write_whole
            if path.name[1:].rsplit(".", 3)[0] in done:
                path.unlink(missing_ok=True)
