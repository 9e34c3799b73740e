"""KITTI's GPS/IMU records: 30 numbers a line, latitude, longitude, altitude, roll, pitch and yaw first.

Poses are in a fixed frame that begins where the first record was taken: Mercator's projection there.
Source: the KITTI raw development kit (Geiger et al., IJRR 2013).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from boxlift.errors import LabelFormatError
from boxlift.poses import Floats, inverse, pose

_EARTH_RADIUS_M = 6378137.0  # the semi-major axis of WGS 84


def imu_poses(lines: Sequence[str], where: str) -> list[Floats]:
    """Records of one drive in their order -> start_SE3_imu (4, 4) of each. Raises LabelFormatError."""
    records = [_record(line, f"{where}:{number}") for number, line in enumerate(lines, start=1)]
    if not records:
        return []
    scale = float(np.cos(np.deg2rad(records[0][0])))
    poses = [_mercator_pose(record, scale) for record in records]
    start = inverse(poses[0])
    return [start @ each for each in poses]


def _record(line: str, where: str) -> Floats:
    try:
        numbers = np.array([float(word) for word in line.split()[:6]])
    except ValueError as error:
        raise LabelFormatError(where, f"{error}.", "Give a GPS/IMU record of KITTI.") from None
    if len(numbers) != 6 or not np.isfinite(numbers).all():
        raise LabelFormatError(where, f"{line[:60]!r} is no GPS/IMU record.", "Give 30 numbers.")
    return numbers


def _mercator_pose(record: Floats, scale: float) -> Floats:
    latitude, longitude, altitude, roll, pitch, yaw = record
    east = scale * np.deg2rad(longitude) * _EARTH_RADIUS_M
    north = scale * _EARTH_RADIUS_M * np.log(np.tan(np.pi / 4 + np.deg2rad(latitude) / 2))
    (cr, cp, cy), (sr, sp, sy) = np.cos((roll, pitch, yaw)), np.sin((roll, pitch, yaw))
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return pose(about_z @ about_y @ about_x, np.array([east, north, altitude]))
