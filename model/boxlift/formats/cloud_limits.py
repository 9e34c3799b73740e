"""How many points a cloud may have, asked as soon as a file says how many it has."""

from __future__ import annotations

from boxlift.errors import PointCloudError


def require_point_count(count: int, max_points: int | None, field: str) -> None:
    """Raises PointCloudError where there are more than `max_points`; None is no limit."""
    if max_points is not None and count > max_points:
        raise PointCloudError(field, f"there are {count} points.", f"Give at most {max_points}.")
