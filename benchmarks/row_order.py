"""Is the order of two columns of numbers, ours and the paper's, the same? For `ablation.py`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Floats


def same_order(ours: Floats, paper: Floats) -> Floats:
    """For every pair of N rows (N (N - 1) / 2,): 1 in the paper's order, -1 in the other, 0 where tied."""
    one, other = np.triu_indices(len(paper), k=1)
    signs: Floats = np.sign(ours[one] - ours[other]) * np.sign(paper[one] - paper[other])
    return signs


def kendall_tau(ours: Floats, paper: Floats) -> float:
    """Kendall's tau-a (1938): 1 for the same order, -1 for the reverse; a tied pair counts as neither."""
    return float(same_order(ours, paper).mean())


def print_pairs(title: str, names: Sequence[str], ours: Mapping[str, Floats], paper: Floats) -> None:
    """How many pairs are in the paper's order, and which are in the other order in every group of `ours`."""
    signs = np.stack([same_order(values, paper) for values in ours.values()])
    everywhere: NDArray[np.bool_] = np.all(signs < 0, axis=0)
    print(
        f"{title}: of {signs.shape[1]} pairs of rows {(signs[0] > 0).sum()} are in the paper's order, "
        f"{(signs[0] == 0).sum()} tied, {(signs[0] < 0).sum()} in the other; "
        f"of these in every group of frames: {everywhere.sum()}"
    )
    first = next(iter(ours.values()))
    for pair, contrary in zip(combinations(range(len(names)), 2), everywhere, strict=True):
        if contrary:
            low, high = sorted(pair, key=lambda row: paper[row])
            print(
                f"    {names[high]} {first[high]:.2f} < {names[low]} {first[low]:.2f}; "
                f"the paper: {paper[high]:.2f} > {paper[low]:.2f}"
            )


def print_effects(title: str, parts: Sequence[str], ours: Mapping[str, Floats], paper: Floats) -> None:
    """What switching one part on changes, over all pairs of rows that differ in that part alone.

    parts: the parts that are on in each row, a letter each.
    """
    row_of = {frozenset(on): row for row, on in enumerate(parts)}
    print(f"{title}: a part switched on, all else equal (ours: recall; the paper: AP in %)")
    for part in sorted(set().union(*row_of)):
        without = [on for on in row_of if part not in on and on | {part} in row_of]
        steps = [(row_of[on], row_of[on | {part}]) for on in without]
        before, after = np.array(steps).T
        theirs = paper[after] - paper[before]
        for group, values in ours.items():
            gain = values[after] - values[before]
            contrary = [
                "+".join(sorted(on)) or "nothing"
                for on, differs in zip(without, gain * theirs < 0, strict=True)
                if differs
            ]
            print(
                f"    {part}  {group:29} mean {gain.mean():+.3f}, the paper {theirs.mean():+6.2f}; "
                f"{int((gain * theirs > 0).sum())} of {len(steps)} of the same sign"
                + (f", not on {', '.join(contrary)}" if contrary else "")
            )
