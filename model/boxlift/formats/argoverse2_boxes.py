"""Boxes of Argoverse 2 files -> labels of sweeps.

A table has a row a box: timestamp_ns, category, length_m, width_m, height_m, qw, qx, qy, qz, tx_m, ty_m, tz_m
in the ego frame, and where known log_id, track_uuid, num_interior_pts (annotations) or score (detections).
Source: the user guide of the Argoverse 2 API (annotations.feather; 3D object detection).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from boxlift.errors import LabelFormatError
from boxlift.formats.tables import read_columns
from boxlift.poses import rotation_of
from boxlift.sweep import EgoObject, SweepLabels

if TYPE_CHECKING:
    from boxlift.storage import AnyPath

_QUATERNION = ("qw", "qx", "qy", "qz")
_CENTER = ("tx_m", "ty_m", "tz_m")
_SIZE = ("length_m", "width_m", "height_m")
_REQUIRED = ("timestamp_ns", "category", *_SIZE, *_QUATERNION, *_CENTER)


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
    rows_of: dict[tuple[str, int], list[int]] = {}
    for row, key in enumerate(zip(logs, times, strict=True)):
        rows_of.setdefault(key, []).append(row)
    return [
        SweepLabels(
            sweep=str(time),
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
            timestamp_ns=time,
        )
        for (of_log, time), rows in rows_of.items()
    ]
