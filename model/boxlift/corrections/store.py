"""Where corrections are kept: SQLite beside the labels, or any database by its URL, through SQLAlchemy.

Nothing is ever changed or deleted: what is taken back is a further row. So who said what and when stays
known, and the unique number of a revision is all that keeps two people from overwriting each other.
"""

from __future__ import annotations

from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from boxlift.corrections.correction import Correction, CorrectionConflictError, Opinion
from boxlift.errors import MissingExtraError, OptionsError

try:
    import sqlalchemy as sql
    from sqlalchemy.exc import ArgumentError, DatabaseError, IntegrityError, NoSuchModuleError
except ModuleNotFoundError:
    raise MissingExtraError("sqlalchemy", "review") from None

FILE_NAME = "corrections.sqlite"

_METADATA = sql.MetaData()
_TABLE = sql.Table(
    "boxlift_corrections",
    _METADATA,
    sql.Column("sequence", sql.Integer, primary_key=True, autoincrement=True),
    sql.Column("label_set", sql.String(500), nullable=False),
    sql.Column("frame", sql.String(500), nullable=False),
    sql.Column("object_index", sql.Integer, nullable=False),
    sql.Column("revision", sql.Integer, nullable=False),
    sql.Column("opinion", sql.JSON, nullable=False),
    sql.Column("author", sql.String(200), nullable=False),
    sql.Column("made_at", sql.DateTime(timezone=True), nullable=False),
    sql.Column("request_id", sql.String(64), nullable=False),
    sql.UniqueConstraint("label_set", "frame", "object_index", "revision"),
    sql.UniqueConstraint("label_set", "request_id"),
    sqlite_autoincrement=True,
)


def default_url(label_set: Path) -> str:
    """The URL of the store that lies beside the labels of `label_set`."""
    return f"sqlite:///{(label_set / FILE_NAME).absolute()}"


class CorrectionStore:
    """Corrections of the label set `name`; several threads and processes may use one database.

    Raises OptionsError where the database cannot be opened.
    """

    def __init__(self, url: str, name: str) -> None:
        self._name = name
        try:
            self._engine = sql.create_engine(url)
            if self._engine.dialect.name == "sqlite":
                sql.event.listen(self._engine, "connect", _durable)
            _METADATA.create_all(self._engine)
        except (ArgumentError, NoSuchModuleError, DatabaseError, ModuleNotFoundError) as error:
            # Without the URL: it may hold a password.
            problem = f"the database cannot be opened ({str(error).splitlines()[0]:.200})."
            remedy = "Give a URL as SQLAlchemy takes it, of a place that can be written to."
            raise OptionsError("corrections", problem, remedy) from None

    def add(
        self,
        frame: str,
        object_index: int,
        opinion: Opinion,
        *,
        based_on: int,
        author: str,
        request_id: str,
    ) -> Correction:
        """Keep an opinion that was formed on revision `based_on` (0: on the machine's label).

        It is on disk when this returns. Raises CorrectionConflictError where that is not the latest one. What
        was kept under the same `request_id` before is returned as it is.
        """
        row = {
            "label_set": self._name,
            "frame": frame,
            "object_index": object_index,
            "revision": based_on + 1,
            "opinion": opinion.model_dump(mode="json"),
            "author": author,
            "made_at": datetime.now(UTC),
            "request_id": request_id,
        }
        last = self._of_object(frame, object_index).order_by(None)
        last = last.with_only_columns(sql.func.coalesce(sql.func.max(_TABLE.c.revision), 0))
        # Whoever was faster by less than this takes the number of the revision.
        with suppress(IntegrityError), self._engine.begin() as connection:
            if connection.scalar(last) == based_on:
                key = connection.execute(sql.insert(_TABLE).values(row)).inserted_primary_key
                assert key is not None
                return _correction({**row, "sequence": key[0]})
        return self._kept_before(frame, object_index, request_id)

    def latest(self, frame: str | None = None, since: int = 0) -> list[Correction]:
        """The latest correction of every object (of one frame), in their order; only those after `since`."""
        wanted = sql.select(_TABLE).where(_TABLE.c.label_set == self._name, _TABLE.c.sequence > since)
        if frame is not None:
            wanted = wanted.where(_TABLE.c.frame == frame)
        said = self._read(wanted.order_by(_TABLE.c.sequence))
        newest = {(each.frame, each.object_index): each for each in said}
        return sorted(newest.values(), key=lambda each: each.sequence)

    def history(self) -> list[Correction]:
        """Everything that was ever said, in its order."""
        wanted = sql.select(_TABLE).where(_TABLE.c.label_set == self._name)
        return self._read(wanted.order_by(_TABLE.c.sequence))

    def close(self) -> None:
        """Let go of the database."""
        self._engine.dispose()

    def _kept_before(self, frame: str, object_index: int, request_id: str) -> Correction:
        """The correction of `request_id`. Raises CorrectionConflictError where there is none."""
        same = sql.select(_TABLE).where(_TABLE.c.label_set == self._name, _TABLE.c.request_id == request_id)
        if kept := self._read(same):
            return kept[0]
        said = self._read(self._of_object(frame, object_index))
        raise CorrectionConflictError(said[-1] if said else None)

    def _of_object(self, frame: str, object_index: int) -> sql.Select[Any]:
        return (
            sql.select(_TABLE)
            .where(
                _TABLE.c.label_set == self._name,
                _TABLE.c.frame == frame,
                _TABLE.c.object_index == object_index,
            )
            .order_by(_TABLE.c.revision)
        )

    def _read(self, wanted: sql.Select[Any]) -> list[Correction]:
        with self._engine.connect() as connection:
            return [_correction(dict(row)) for row in connection.execute(wanted).mappings()]


def _correction(row: dict[str, Any]) -> Correction:
    made_at = row["made_at"]
    if made_at.tzinfo is None:  # SQLite keeps none
        made_at = made_at.replace(tzinfo=UTC)
    del row["label_set"]
    return Correction.model_validate({**row, "made_at": made_at})


def _durable(connection: Any, _: object) -> None:
    """What was committed is on disk; readers and a writer do not wait for each other."""
    cursor = connection.cursor()
    for pragma in ("journal_mode = WAL", "synchronous = FULL", "busy_timeout = 10000"):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()
