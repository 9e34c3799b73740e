"""Tables of boxes as Argoverse 2 has them <-> labels of sweeps.

A table has a row a box: timestamp_ns, category, length_m, width_m, height_m, qw, qx, qy, qz, tx_m, ty_m, tz_m
in the ego frame, and where known log_id, track_uuid, num_interior_pts (annotations) or score (detections).
Source: the user guide of the Argoverse 2 API (annotations.feather; 3D object detection).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from boxlift.errors import LabelFormatError, MissingExtraError
from boxlift.formats.class_names import argoverse2_class
from boxlift.formats.tables import read_columns
from boxlift.poses import quaternion_of, rotation_of
from boxlift.storage import writing_whole
from boxlift.sweep import EgoObject, SweepLabels

if TYPE_CHECKING:
    from boxlift.storage import AnyPath

_QUATERNION = ("qw", "qx", "qy", "qz")
_CENTER = ("tx_m", "ty_m", "tz_m")
_SIZE = ("length_m", "width_m", "height_m")
_REQUIRED = ("timestamp_ns", "category", *_SIZE, *_QUATERNION, *_CENTER)
_COLUMNS = {
    "log_id": "string",
    "timestamp_ns": "int64",
    "track_uuid": "string",
    "category": "string",
    **dict.fromkeys((*_SIZE, *_QUATERNION, *_CENTER), "float64"),
    "num_interior_pts": "int64",
    "score": "float64",
    "sweep": "string",
    "cameras": "string",
    "flags": "string",
}
_ROWS_AT_ONCE = 100_000


def read_boxes(path: AnyPath, log: str = "") -> list[SweepLabels]:
    """Labels by sweep, which is named by its timestamp. log: of files without a column log_id.

    Raises LabelFormatError where the file is no such table, MissingExtraError without pyarrow, OSError.
    """
    columns = read_columns(path)
    missing = [name for name in _REQUIRED if name not in columns]
    if missing:
        raise LabelFormatError(
            str(path),
            f"there is no column {', '.join(missing)}.",
            "Give Argoverse 2 annotations or detections.",
        )
    count = len(columns["timestamp_ns"])
    try:
        centers, sizes, quaternions = (
            np.array([columns[name] for name in names], dtype=np.float64).T.reshape(count, len(names))
            for names in (_CENTER, _SIZE, _QUATERNION)
        )
        times = [int(value) for value in columns["timestamp_ns"]]
        scores = [float(value) for value in columns.get("score", [1.0] * count)]
        points = [
            None if value is None else int(value) for value in columns.get("num_interior_pts", [None] * count)
        ]
    except (TypeError, ValueError) as error:
        raise LabelFormatError(str(path), f"a number is missing ({error}).", "Leave such rows out.") from None
    if not np.linalg.norm(quaternions, axis=1).all():
        raise LabelFormatError(str(path), "a box has the rotation 0, 0, 0, 0.", "Leave such rows out.")
    rotations = rotation_of(quaternions)
    logs = [str(value) for value in columns.get("log_id", [log] * count)]
    tracks = columns.get("track_uuid", [None] * count)
    sweeps = [str(value) for value in columns.get("sweep", times)]
    rows_of: dict[tuple[str, str], list[int]] = {}
    for row, key in enumerate(zip(logs, sweeps, strict=True)):
        rows_of.setdefault(key, []).append(row)
    return [
        SweepLabels(
            sweep=sweep,
            objects=tuple(
                EgoObject(
                    category=str(columns["category"][row]),
                    center_ego=centers[row],
                    ego_SO3_object=rotations[row],
                    length_m=float(sizes[row, 0]),
                    width_m=float(sizes[row, 1]),
                    height_m=float(sizes[row, 2]),
                    score=scores[row],
                    track_id=None if tracks[row] is None else str(tracks[row]),
                    points=points[row],
                )
                for row in rows
            ),
            log=of_log,
            timestamp_ns=times[rows[0]],
        )
        for (of_log, sweep), rows in rows_of.items()
    ]


def write_boxes(sweeps: Iterable[SweepLabels], path: AnyPath) -> int:
    """Labels as a table, and how many rows it has; by its suffix Parquet or Feather.

    Classes get the names of Argoverse 2. Besides the columns above there are `sweep`, `cameras` and `flags`
    (separated by spaces). Where the sweep's time is not known, timestamp_ns is its place in the order given.

    Raises MissingExtraError without pyarrow, OSError.
    """
    try:
        import pyarrow
        from pyarrow import feather, parquet
    except ImportError:
        raise MissingExtraError("pyarrow", "client") from None
    schema = pyarrow.schema([(name, getattr(pyarrow, kind)()) for name, kind in _COLUMNS.items()])
    rows: list[dict[str, Any]] = []
    count = 0
    with writing_whole(path) as file:
        writer = parquet.ParquetWriter(file, schema) if path.suffix == ".parquet" else None
        for place, sweep in enumerate(sweeps):
            rows += [_row(each, sweep, place) for each in sweep.objects]
            if writer is not None and len(rows) >= _ROWS_AT_ONCE:
                writer.write_table(pyarrow.Table.from_pylist(rows, schema))
                count, rows = count + len(rows), []
        table = pyarrow.Table.from_pylist(rows, schema)
        if writer is None:
            feather.write_feather(table, file)
        else:
            writer.write_table(table)
            writer.close()
    return count + len(rows)


def _row(each: EgoObject, sweep: SweepLabels, place: int) -> dict[str, Any]:
    return {
        "log_id": sweep.log,
        "timestamp_ns": place if sweep.timestamp_ns is None else sweep.timestamp_ns,
        "track_uuid": each.track_id,
        "category": argoverse2_class(each.category),
        **dict(zip(_SIZE, (each.length_m, each.width_m, each.height_m), strict=True)),
        **dict(zip(_QUATERNION, quaternion_of(each.ego_SO3_object), strict=True)),
        **dict(zip(_CENTER, each.center_ego.tolist(), strict=True)),
        "num_interior_pts": each.points,
        "score": each.score,
        "sweep": sweep.sweep,
        "cameras": " ".join(each.cameras),
        "flags": " ".join(each.flags),
    }
