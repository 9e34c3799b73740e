"""KITTI's greedy matching of truths and detections, for all frames and score thresholds at once.

The development kit walks through the truths of a frame in the order of the file; each takes the
detection that it likes best among those not yet taken. Frames and thresholds do not touch each other, so
the first truths of all frames choose together, then the second ones, and so on.
"""

from __future__ import annotations

import numpy as np

from boxlift.evaluation.label_table import Indices, Mask


def choose_in_turn(
    truth: Indices, wish: Indices, truth_frame: Indices, taken: Mask
) -> tuple[Indices, Indices]:
    """Let every truth take its first free wish.

    truth, wish: (P,) pairs of a truth and a detection that it would take, sorted by truth (which is
        also the order in which the truths of a frame choose) and then by preference.
    truth_frame: (N,) frame of every truth, ascending.
    taken: (M, T) what is not free at each of T thresholds. Becomes True where a detection is chosen.

    Returns the truths (R,) that have a wish, and their choices (R, T) as indices of detections, -1 where
    all wishes were taken.
    """
    truths, first_pair, wishes = np.unique(truth, return_index=True, return_counts=True)
    thresholds = np.arange(taken.shape[1])
    choices = np.full((len(truths), len(thresholds)), -1)
    if len(truths) == 0:
        return truths, choices

    place = np.arange(len(truth)) - np.repeat(first_pair, wishes)
    wish_list = np.full((len(truths), wishes.max()), -1)
    wish_list[np.repeat(np.arange(len(truths)), wishes), place] = wish

    frame = truth_frame[truths]
    turn = np.arange(len(truths)) - np.searchsorted(frame, frame)
    for now in range(turn.max() + 1):
        choosing = np.flatnonzero(turn == now)
        wanted = wish_list[choosing]
        chosen = np.full((len(choosing), len(thresholds)), -1)
        for rank in range(wanted.shape[1]):
            free = (wanted[:, rank, None] >= 0) & ~taken[wanted[:, rank]] & (chosen < 0)
            chosen = np.where(free, wanted[:, rank, None], chosen)
        row, column = np.nonzero(chosen >= 0)
        taken[chosen[row, column], thresholds[column]] = True
        choices[choosing] = chosen
    return truths, choices
