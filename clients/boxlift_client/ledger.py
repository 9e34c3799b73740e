"""The ledger of a label set: what became of every frame, one row per attempt.

    OUT/ledger/20261126T081502-3f9a1c20-000001.parquet

Append-only Parquet parts, each written whole and never touched again; the ledger is all of them, in any
order. A database in one file (SQLite in WAL mode) would take every row at once, but it needs shared memory
and locks, which network file systems and object stores lack, and has one writer; here a hundred machines
append to one ledger in a bucket, and any tool that reads Parquet can ask it.

The price: rows wait in memory for a part, and a runner that is killed takes its last seconds' rows with it.
Their frames are labelled again, into the same bytes. So that a weekend does not end in a million parts, a
run waits the longer for a part the longer it has run: a hundredth of its time, from 5 to 60 seconds.
"""

from __future__ import annotations

import io
import secrets
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, field, fields
from datetime import UTC, datetime
from time import monotonic
from typing import TYPE_CHECKING

from boxlift.label_sets.ledger_parts import ledger_tables, pyarrow_modules
from boxlift.storage import write_whole
from boxlift_client.errors import RunStoppedError
from boxlift_client.job import FrameReport, Outcome

if TYPE_CHECKING:
    from boxlift.storage import AnyPath

_SHORTEST_WAIT_S, _LONGEST_WAIT_S = 5.0, 60.0
_MOST_ROWS_WAITING = 10_000


@dataclass(frozen=True)
class LedgerRow:
    """What became of one frame in one attempt.

    source: id of its data set in the manifest. results: prompts per result. digest: SHA-256 over the bytes of
    its label files, None where it failed. attempt: from 1.
    """

    frame: str
    source: str
    outcome: str
    prompts: int
    boxes: int
    results: dict[str, int]
    warnings: int
    seconds: float
    error: str | None
    attempt: int
    digest: str | None
    finished_at: datetime

    @classmethod
    def of(cls, report: FrameReport, source: str, attempt: int) -> LedgerRow:
        """The row of a report."""
        return cls(
            frame=report.frame,
            source=source,
            outcome=str(report.outcome),
            prompts=len(report.results),
            boxes=report.boxes,
            results=dict(sorted(Counter(result for result, _ in report.results).items())),
            warnings=len(report.warnings),
            seconds=report.seconds,
            error=report.sentence or None,
            attempt=attempt,
            digest=report.digest,
            finished_at=datetime.now(UTC),
        )


class LedgerWriter:
    """Appends rows to the ledger in `folder`. Not for several threads."""

    def __init__(self, folder: AnyPath, clock: Callable[[], float] = monotonic) -> None:
        self._folder = folder
        self._clock = clock
        self._start_s = self._last_s = clock()
        self._name = f"{datetime.now(UTC):%Y%m%dT%H%M%S}-{secrets.token_hex(4)}"
        self._parts = 0
        self._rows: list[LedgerRow] = []

    def add(self, row: LedgerRow) -> None:
        """Take a row; a part is written when it is time."""
        self._rows.append(row)
        now_s = self._clock()
        wait_s = min(max((now_s - self._start_s) / 100, _SHORTEST_WAIT_S), _LONGEST_WAIT_S)
        if now_s - self._last_s >= wait_s or len(self._rows) >= _MOST_ROWS_WAITING:
            self.flush()

    def flush(self) -> None:
        """Write the rows that wait. Raises RunStoppedError where that fails; they go on waiting then."""
        self._last_s = self._clock()
        if not self._rows:
            return
        path = self._folder / f"{self._name}-{self._parts + 1:06d}.parquet"
        try:
            write_whole(path, _parquet(self._rows))
        except OSError as error:
            raise RunStoppedError(f"The ledger cannot be written to {path} ({error}).") from None
        self._parts += 1
        self._rows = []


@dataclass
class LedgerState:
    """What the ledger says when all its rows are read.

    done: frames that have labels, or were skipped -> which. failed: frames that have none -> attempts so far
    and the sentence of the last. foreign: frames of other sources -> the id of theirs. The counts are of done
    frames, each once.
    """

    done: dict[str, Outcome] = field(default_factory=dict)
    failed: dict[str, tuple[int, str]] = field(default_factory=dict)
    foreign: dict[str, str] = field(default_factory=dict)
    prompts: int = 0
    boxes: int = 0

    def attempts(self, frame: str) -> int:
        """How often a frame has failed."""
        return self.failed.get(frame, (0, ""))[0]


def read_ledger(folder: AnyPath, source: str | None = None) -> LedgerState:
    """All rows of a ledger; none where there is no ledger yet. `source`: whose frames are not foreign.

    Once done a frame stays done, whatever order the parts are read in. Raises LabelFormatError where a part
    cannot be read.
    """
    state = LedgerState()
    columns = ["frame", "source", "outcome", "prompts", "boxes", "error", "attempt"]
    for table in ledger_tables(folder, columns):
        for frame, of_source, outcome, prompts, boxes, error, attempt in zip(
            *(table[name].to_pylist() for name in columns), strict=True
        ):
            if source is not None and of_source != source:
                state.foreign[frame] = of_source
            if frame in state.done:
                continue
            if outcome == Outcome.FAILED:
                state.failed[frame] = max(state.failed.get(frame, (0, "")), (attempt, error or ""))
                continue
            state.done[frame] = Outcome(outcome)
            state.prompts += prompts
            state.boxes += boxes
    for frame in state.failed.keys() & state.done:
        del state.failed[frame]
    return state


def read_rows(folder: AnyPath) -> Iterator[LedgerRow]:
    """Every row of a ledger, part by part. Raises LabelFormatError where a part cannot be read."""
    names = [each.name for each in fields(LedgerRow)]
    for table in ledger_tables(folder, names):
        for row in table.to_pylist():
            yield LedgerRow(**{**row, "results": dict(row["results"])})


def _parquet(rows: Iterable[LedgerRow]) -> bytes:
    """Rows -> the bytes of a Parquet file."""
    arrow, parquet = pyarrow_modules()
    schema = arrow.schema(
        [
            arrow.field("frame", arrow.string(), nullable=False),
            arrow.field("source", arrow.string(), nullable=False),
            arrow.field("outcome", arrow.string(), nullable=False),
            arrow.field("prompts", arrow.int32()),
            arrow.field("boxes", arrow.int32()),
            arrow.field("results", arrow.map_(arrow.string(), arrow.int32())),
            arrow.field("warnings", arrow.int32()),
            arrow.field("seconds", arrow.float32()),
            arrow.field("error", arrow.string()),
            arrow.field("attempt", arrow.int16()),
            arrow.field("digest", arrow.string()),
            arrow.field("finished_at", arrow.timestamp("us", tz="UTC")),
        ]
    )
    table = arrow.Table.from_pylist([asdict(row) for row in rows], schema=schema)
    buffer = io.BytesIO()
    parquet.write_table(table, buffer, compression="zstd")
    return buffer.getvalue()
