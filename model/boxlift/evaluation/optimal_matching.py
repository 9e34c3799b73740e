"""Which prediction finds which truth, at every score cutoff at once: the matching of the largest summed IoU.

Waymo's metric matches anew at each cutoff, among the predictions that reach it. As the cutoff falls,
predictions only join in, and what a pair of boxes shares with others is mostly nothing: a truth and the
predictions that overlap no other truth. There the truth takes the largest overlap, so that a prediction holds
it from its own score up to that of the first better one. Only where a prediction overlaps two truths is an
assignment problem solved, per group of boxes that hang together.

Source: HungarianMatcher in waymo_open_dataset/metrics/matcher.cc (weights: IoU in millionths, 0 below the
threshold; a pair below it never matches).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Floats
from boxlift.evaluation.label_table import Indices

_WEIGHT_OF_FULL_OVERLAP = 1_000_000  # kMaxIoU


@dataclass(frozen=True)
class Matches:
    """M times that a prediction holds a truth: at cutoffs c with above < c <= up_to."""

    truth: Indices
    prediction: Indices
    above: Floats
    up_to: Floats


def match_at_every_cutoff(truth: Indices, prediction: Indices, iou: Floats, score: Floats) -> Matches:
    """truth, prediction, iou: (P,) pairs that may match. score: of all predictions, finite.

    Where two predictions overlap a truth alike, the one of the higher score takes it, then the first.
    """
    weight = np.rint(iou * _WEIGHT_OF_FULL_OVERLAP).astype(np.int64)
    _, of_prediction, truths = np.unique(prediction, return_inverse=True, return_counts=True)
    crowded = truths[of_prediction] > 1
    groups: list[Indices] = []
    if crowded.any():
        group = group_of_pairs(truth, prediction)
        crowded = np.isin(group, group[crowded])
        groups = _rows_by(group, np.flatnonzero(crowded))
    parts = [_largest_first(truth[~crowded], prediction[~crowded], weight[~crowded], score)]
    parts += [_assigned(truth[rows], prediction[rows], weight[rows], score) for rows in groups]
    return Matches(
        np.concatenate([part.truth for part in parts]),
        np.concatenate([part.prediction for part in parts]),
        np.concatenate([part.above for part in parts]),
        np.concatenate([part.up_to for part in parts]),
    )


def group_of_pairs(truth: Indices, prediction: Indices) -> Indices:
    """(P,) the same number for pairs that share a truth or a prediction, directly or over others."""
    group = np.arange(len(truth))
    _, by_truth = np.unique(truth, return_inverse=True)
    _, by_prediction = np.unique(prediction, return_inverse=True)
    while True:
        before = group
        for member in (by_truth, by_prediction):
            least = np.full(len(group), len(group))
            np.minimum.at(least, member, group)
            group = least[member]
        if np.array_equal(before, group):
            return group


def largest_sum(weight: NDArray[np.int64]) -> Indices:
    """(R, C) weights of at least 0 -> (R,) the column of each row, -1 where it has none, so that their sum
    is largest and no column is taken twice.

    The Hungarian method with potentials: rows enter one by one, each along the cheapest augmenting path.
    """
    rows, columns = weight.shape
    cost = np.zeros((rows, max(rows, columns)), dtype=np.int64)
    cost[:, :columns] = -weight
    width = cost.shape[1]
    row_potential = np.zeros(rows + 1, dtype=np.int64)
    column_potential = np.zeros(width + 1, dtype=np.int64)
    row_of = np.zeros(width + 1, dtype=np.int64)  # row + 1 that holds column - 1; 0: none
    for row in range(1, rows + 1):
        row_of[0], column = row, 0
        least = np.full(width + 1, np.iinfo(np.int64).max)
        came_from = np.zeros(width + 1, dtype=np.int64)
        visited = np.zeros(width + 1, dtype=np.bool_)
        while True:
            visited[column] = True
            holder = row_of[column]
            reduced = cost[holder - 1] - row_potential[holder] - column_potential[1:]
            shorter = ~visited[1:] & (reduced < least[1:])
            least[1:][shorter] = reduced[shorter]
            came_from[1:][shorter] = column
            free = np.flatnonzero(~visited[1:]) + 1
            nearest = int(free[np.argmin(least[free])])
            step = least[nearest]
            row_potential[row_of[visited]] += step
            column_potential[visited] -= step
            least[free] -= step
            column = nearest
            if row_of[column] == 0:
                break
        while column != 0:
            row_of[column] = row_of[came_from[column]]
            column = int(came_from[column])
    answer = np.full(rows, -1, dtype=np.int64)
    held = np.flatnonzero(row_of[1 : columns + 1])
    answer[row_of[held + 1] - 1] = held
    return answer


def _largest_first(truth: Indices, prediction: Indices, weight: Indices, score: Floats) -> Matches:
    """Every prediction overlaps one truth: it holds it from its score up to that of a better one."""
    own = score[prediction]
    order = np.lexsort((prediction, -own, -weight, truth))
    truth, prediction, own = truth[order], prediction[order], own[order]
    # The highest score of the better ones: a running maximum that starts anew with each truth.
    levels, level = np.unique(own, return_inverse=True)
    is_first = truth[1:] != truth[:-1]
    turn = np.concatenate([[0], np.cumsum(is_first)])[: len(truth)] * len(levels)
    best_level = np.maximum.accumulate(turn + level) - turn
    above = np.full(len(truth), -np.inf)
    above[1:] = np.where(is_first, -np.inf, levels[best_level[:-1]])
    holds = above < own
    return Matches(truth[holds], prediction[holds], above[holds], own[holds])


def _assigned(truth: Indices, prediction: Indices, weight: Indices, score: Floats) -> Matches:
    """One group of boxes: an assignment for every set of predictions that a cutoff leaves."""
    truths, row = np.unique(truth, return_inverse=True)
    predictions = np.unique(prediction)
    predictions = predictions[np.lexsort((predictions, -score[predictions]))]
    place = {int(index): rank for rank, index in enumerate(predictions)}
    column = np.array([place[int(index)] for index in prediction])
    table = np.zeros((len(truths), len(predictions)), dtype=np.int64)
    table[row, column] = weight
    own = score[predictions]
    last_of_level = np.flatnonzero(np.append(own[1:] != own[:-1], True))
    found: list[tuple[int, int, float, float]] = []
    for last in last_of_level:
        next_score = own[last + 1] if last + 1 < len(own) else -np.inf
        active = table[:, : last + 1]
        for which, taken in enumerate(largest_sum(active)):
            if taken >= 0 and active[which, taken] > 0:
                pair = int(truths[which]), int(predictions[taken])
                found.append((*pair, float(next_score), float(own[last])))
    columns = np.array(found, dtype=np.float64).reshape(-1, 4).T
    return Matches(columns[0].astype(np.int64), columns[1].astype(np.int64), columns[2], columns[3])


def _rows_by(group: Indices, rows: Indices) -> list[Indices]:
    """The rows of each group."""
    order = rows[np.argsort(group[rows], kind="stable")]
    return np.split(order, np.flatnonzero(np.diff(group[order])) + 1)
