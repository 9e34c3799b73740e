"""Boxes in the ego frame for evaluation tests."""

from __future__ import annotations

import numpy as np

from boxlift.sweep import EgoObject, SweepLabels


def ego_box(
    category: str = "Vehicle",
    x: float = 20.0,
    y: float = 0.0,
    *,
    z: float = 0.0,
    yaw_rad: float = 0.0,
    score: float = 1.0,
    length_m: float = 4.0,
    points: int | None = 100,
    difficulty: int | None = None,
    attribute: str | None = None,
) -> EgoObject:
    """A box of 4 x 2 x 1.5 m, x ahead and y to the left."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    return EgoObject(
        category,
        np.array([x, y, z]),
        np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]),
        length_m,
        2.0,
        1.5,
        score,
        points=points,
        difficulty=difficulty,
        attribute=attribute,
    )


def sweep(*objects: EgoObject, name: str = "0", log: str = "") -> SweepLabels:
    """One sweep."""
    return SweepLabels(name, objects, log)


def sweeps(*per_sweep: list[EgoObject]) -> list[SweepLabels]:
    """Sweeps 0, 1, 2, ..."""
    return [sweep(*objects, name=str(index)) for index, objects in enumerate(per_sweep)]
