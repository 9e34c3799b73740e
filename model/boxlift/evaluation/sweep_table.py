"""The labels of many sweeps as one struct of arrays: what the metrics in the ego frame compute on."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxlift.boxes import Boxes3D
from boxlift.camera import Floats
from boxlift.errors import DatasetError
from boxlift.evaluation.label_table import Indices, Mask
from boxlift.sweep import EgoObject, SweepLabels

UNKNOWN_COUNT = -1

_NAMES_IN_ERROR = 3
_PAIRS_AT_ONCE = 200_000  # some 100 MB while their overlaps are computed

_Key = tuple[str, str]
_ClassOf = Callable[[str], int | None]


@dataclass(frozen=True)
class SweepTable:
    """N objects, in the order of the sweeps and, within a sweep, of its objects.

    sweep: (N,) index of the sweep, ascending. category: (N,) index of the class.
    boxes: N boxes with the axes of a camera that looks along the ego frame's x (x right, y down, z forward).
    range_3d_m, range_xy_m: (N,) distances of the centres from the ego frame's origin, and from its z axis.
    score: (N,). points, difficulty: (N,), UNKNOWN_COUNT where they are not known. attribute: (N,), "" where
    there is none.
    """

    sweep: Indices
    category: Indices
    boxes: Boxes3D
    range_3d_m: Floats
    range_xy_m: Floats
    score: Floats
    points: Indices
    difficulty: Indices
    attribute: NDArray[np.str_]

    def __len__(self) -> int:
        return len(self.sweep)

    @classmethod
    def of(cls, objects: Sequence[EgoObject], sweep: Sequence[int], category: Sequence[int]) -> SweepTable:
        """Objects (N), each with the index of its sweep and of its class."""
        center = np.array([each.center_ego for each in objects], dtype=np.float64).reshape(-1, 3)
        x, y, z = center.T
        size_m = np.array(
            [(each.length_m, each.width_m, each.height_m) for each in objects], dtype=np.float64
        ).reshape(-1, 3)
        length, width, height = size_m.T
        yaw = np.array([each.yaw_rad for each in objects], dtype=np.float64)
        return cls(
            sweep=np.array(sweep, dtype=np.int64),
            category=np.array(category, dtype=np.int64),
            # The heading (cos yaw, sin yaw) in x, y is (cos r, 0, -sin r) in -y, -z, x at r = -yaw - 90 deg.
            boxes=Boxes3D(np.stack([-y, -z, x], axis=1), length, width, height, -yaw - np.pi / 2),
            range_3d_m=np.linalg.norm(center, axis=1),
            range_xy_m=np.hypot(x, y),
            score=np.array([each.score for each in objects], dtype=np.float64),
            points=_counts(each.points for each in objects),
            difficulty=_counts(each.difficulty for each in objects),
            attribute=np.array([each.attribute or "" for each in objects], dtype=np.str_),
        )

    def rows(self, index: Mask | Indices) -> SweepTable:
        """The objects at `index`: a mask (N,), or indices."""
        return SweepTable(
            sweep=self.sweep[index],
            category=self.category[index],
            boxes=self.boxes[index],
            range_3d_m=self.range_3d_m[index],
            range_xy_m=self.range_xy_m[index],
            score=self.score[index],
            points=self.points[index],
            difficulty=self.difficulty[index],
            attribute=self.attribute[index],
        )


@dataclass(frozen=True)
class JudgedSweeps:
    """Truths and predictions of the sweeps that are judged: all that have a truth.

    sweep_count: how many. without_predictions: sweeps of which nothing is said; they count as if nothing had
    been found. without_truth: sweeps that only the predictions have; they are left out. other_truths,
    other_predictions: objects left out by class, for their class is not judged.
    """

    sweep_count: int
    truths: SweepTable
    predictions: SweepTable
    without_predictions: int
    without_truth: int
    other_truths: Mapping[str, int]
    other_predictions: Mapping[str, int]


def judged_sweeps(
    truth: Iterable[SweepLabels], predictions: Iterable[SweepLabels], class_of: _ClassOf
) -> JudgedSweeps:
    """Bring truths and predictions together by the names of their sweeps, in the order of the names.

    Where both sides name their logs, a sweep's name has to be unique in its log only. class_of: name of a
    class as labels have it -> index of the class it is judged as, None where it is not.

    Raises DatasetError where there is no truth, where no sweep has predictions (the names differ), where a
    sweep is there twice, and where a box or a score is not finite.
    """
    true_sweeps, found_sweeps = list(truth), list(predictions)
    if not true_sweeps:
        raise DatasetError("gt", "there is no sweep to judge.", "Give the truth of at least one sweep.")
    logs_named = all(each.log for each in (*true_sweeps, *found_sweeps))
    truth_of = _by_key(true_sweeps, "gt", logs_named)
    found_of = _by_key(found_sweeps, "pred", logs_named)
    keys = sorted(truth_of)
    missing = [key for key in keys if key not in found_of]
    if len(missing) == len(keys):
        ours, theirs = (", ".join(name for _, name in each[:_NAMES_IN_ERROR]) for each in (keys, [*found_of]))
        raise DatasetError(
            "pred",
            f"no sweep of the truth ({ours}, ...) has predictions, which are of {theirs or 'no sweep'}.",
            "Give predictions of the same sweeps, under the same names.",
        )
    truths, other_truths = _table(keys, truth_of, class_of, "gt")
    found, other_predictions = _table(keys, found_of, class_of, "pred")
    return JudgedSweeps(
        sweep_count=len(keys),
        truths=truths,
        predictions=found,
        without_predictions=len(missing),
        without_truth=len(found_of.keys() - truth_of.keys()),
        other_truths=other_truths,
        other_predictions=other_predictions,
    )


def sweep_pairs(truths: SweepTable, predictions: SweepTable) -> Iterator[tuple[Indices, Indices]]:
    """Every truth with every prediction of its sweep: (P,) indices into both, in order of the truths.

    In parts of about _PAIRS_AT_ONCE pairs, so that what is computed of them stays small.
    """
    starts = np.searchsorted(predictions.sweep, truths.sweep, side="left")
    partners = np.searchsorted(predictions.sweep, truths.sweep, side="right") - starts
    part = np.cumsum(partners) // _PAIRS_AT_ONCE
    for chosen in np.split(np.arange(len(truths)), np.flatnonzero(np.diff(part)) + 1):
        rows = np.repeat(chosen, partners[chosen])
        before = np.repeat(np.cumsum(partners[chosen]) - partners[chosen], partners[chosen])
        yield rows, np.arange(len(rows)) - before + starts[rows]


def _counts(values: Iterable[int | None]) -> Indices:
    return np.array([UNKNOWN_COUNT if value is None else value for value in values], dtype=np.int64)


def _by_key(sweeps: Sequence[SweepLabels], field: str, logs_named: bool) -> dict[_Key, SweepLabels]:
    by_key: dict[_Key, SweepLabels] = {}
    for each in sweeps:
        key = (each.log if logs_named else "", each.sweep)
        if key in by_key:
            raise DatasetError(field, f"sweep {each.sweep!r} is there twice.", "Give every sweep once.")
        by_key[key] = each
    return by_key


def _table(
    keys: Sequence[_Key], labels: Mapping[_Key, SweepLabels], class_of: _ClassOf, field: str
) -> tuple[SweepTable, dict[str, int]]:
    objects: list[EgoObject] = []
    sweep: list[int] = []
    category: list[int] = []
    other: Counter[str] = Counter()
    for index, key in enumerate(keys):
        for each in labels[key].objects if key in labels else ():
            if (judged_as := class_of(each.category)) is None:
                other[each.category] += 1
            else:
                objects.append(each)
                sweep.append(index)
                category.append(judged_as)
    table = SweepTable.of(objects, sweep, category)
    boxes = table.boxes
    numbers = (*boxes.center_cam.T, boxes.length_m, boxes.width_m, boxes.height_m, boxes.rotation_y)
    finite = np.isfinite([*numbers, table.score]).all(axis=0)
    if not finite.all():
        where = keys[table.sweep[int(np.argmin(finite))]][1]
        raise DatasetError(
            field, f"sweep {where!r} has a box or a score that is not finite.", "Leave such objects out."
        )
    return table, dict(sorted(other.items()))
