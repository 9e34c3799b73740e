"""How well track ids keep to one object: the identity switches of the CLEAR MOT metrics.

Source: Bernardin and Stiefelhagen, "Evaluating Multiple Object Tracking Performance: The CLEAR MOT Metrics",
EURASIP Journal on Image and Video Processing, 2008. As for pseudo labels, a truth is judged by the box of its
own prompt: image boxes are associated one to one, largest IoU first, at least 0.5.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from boxlift.formats.kitti_label import KittiObject
from boxlift.overlap import iou_2d

_MIN_IOU = 0.5

# A track and its line in one frame.
Tracked = tuple[int, KittiObject]


@dataclass(frozen=True)
class Identities:
    """Of the tracks of a truth: how many there are, and how many boxes were associated with them.

    switches: boxes whose track differs from that of the truth's box before. tracks_found: tracks that have a
    share in the truth, so that of one truth each there are as many as truths.
    """

    truths: int
    associated: int
    switches: int
    tracks_found: int


@dataclass
class _Seen:
    last: int
    found: set[int] = field(default_factory=set)


def judge_identities(frames: Iterable[tuple[Sequence[Tracked], Sequence[Tracked]]]) -> Identities:
    """Truth and prediction of one drive, frame by frame in the order of time."""
    seen: dict[int, _Seen] = {}
    truths: set[int] = set()
    associated = switches = 0
    for truth, prediction in frames:
        truths |= {track for track, _ in truth}
        for true_track, track in _associated(truth, prediction):
            associated += 1
            before = seen.setdefault(true_track, _Seen(track))
            switches += before.last != track
            before.last = track
            before.found.add(track)
    return Identities(len(truths), associated, switches, sum(len(each.found) for each in seen.values()))


def _associated(truth: Sequence[Tracked], prediction: Sequence[Tracked]) -> list[tuple[int, int]]:
    """(track of the truth, track of the prediction) of every pair."""
    true_px, found_px = (
        np.array([line.box_px for _, line in lines]).reshape(-1, 4) for lines in (truth, prediction)
    )
    rows, columns = (grid.ravel() for grid in np.indices((len(truth), len(prediction))))
    iou = iou_2d(true_px[rows], found_px[columns])
    pairs: dict[int, int] = {}
    for at in np.argsort(-iou, kind="stable"):
        if iou[at] < _MIN_IOU:
            break
        if rows[at] not in pairs and columns[at] not in pairs.values():
            pairs[int(rows[at])] = int(columns[at])
    return [(truth[row][0], prediction[column][0]) for row, column in sorted(pairs.items())]
