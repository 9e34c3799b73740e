"""Frames of a recording and the transforms between them over time."""

from __future__ import annotations

import bisect
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from boxlift.poses import Floats, inverse, pose, rotation_of


@dataclass(frozen=True)
class TimedTransform:
    """parent_SE3_child at a time: translation (3,) in metres, quaternion (4,) w, x, y, z."""

    parent: str
    child: str
    time_ns: int
    translation_m: Floats
    quaternion_wxyz: Floats


class TransformTree:
    """Transforms of a stretch of a recording."""

    def __init__(self, transforms: Iterable[TimedTransform]) -> None:
        self._to_parent: dict[str, list[TimedTransform]] = {}
        for each in sorted(transforms, key=lambda transform: transform.time_ns):
            self._to_parent.setdefault(each.child, []).append(each)

    def between(self, target: str, source: str, time_ns: int) -> Floats | None:
        """target_SE3_source (4, 4) at a time; None where no chain of transforms leads there."""
        ups, downs = self._chain(source, time_ns), self._chain(target, time_ns)
        common = next((frame for frame in ups if frame in downs), None)
        return None if common is None else inverse(downs[common]) @ ups[common]

    def _chain(self, frame: str, time_ns: int) -> dict[str, Floats]:
        """ancestor_SE3_frame of the frame itself and everything above it."""
        found, matrix = {frame: np.eye(4)}, np.eye(4)
        while (steps := self._to_parent.get(frame)) is not None:
            frame = steps[0].parent
            if frame in found:  # a ring
                break
            matrix = _at(steps, time_ns) @ matrix
            found[frame] = matrix
        return found


def _at(steps: list[TimedTransform], time_ns: int) -> Floats:
    """Between the two that surround the time; the nearest at either end."""
    at = bisect.bisect([each.time_ns for each in steps], time_ns)
    before, after = steps[max(at - 1, 0)], steps[min(at, len(steps) - 1)]
    span = after.time_ns - before.time_ns
    share = min(max((time_ns - before.time_ns) / span, 0.0), 1.0) if span else 0.0
    same_way = 1.0 if before.quaternion_wxyz @ after.quaternion_wxyz >= 0 else -1.0
    quaternion = (1 - share) * before.quaternion_wxyz + share * same_way * after.quaternion_wxyz
    translation = (1 - share) * before.translation_m + share * after.translation_m
    return pose(rotation_of(quaternion[None])[0], translation)
