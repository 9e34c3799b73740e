"""Do probabilities hold? Bins of equally many predictions, and the expected calibration error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Floats

BINS = 10


@dataclass(frozen=True)
class Bin:
    """`count` predictions next to each other in order: their mean probability, and the share that held."""

    count: int
    probability: float
    held: float


def reliability(
    probabilities: Floats, outcomes: NDArray[np.bool_], bins: int = BINS
) -> tuple[list[Bin], float]:
    """(N,) probabilities and what happened (N,) -> bins of equal mass, rising, and the calibration error.

    The error is the mean over predictions of the distance between a bin's probability and the share that
    held (Naeini et al., "Obtaining Well Calibrated Probabilities Using Bayesian Binning", AAAI 2015), with
    bins of equal mass instead of equal width. Nan where there is no prediction.
    """
    order = np.argsort(probabilities, kind="stable")
    parts = [part for part in np.array_split(order, bins) if len(part)]
    found = [
        Bin(len(rows), float(probabilities[rows].mean()), float(outcomes[rows].mean())) for rows in parts
    ]
    error = sum(part.count * abs(part.probability - part.held) for part in found)
    return found, error / len(order) if found else float("nan")


def print_reliability(title: str, probabilities: Floats, outcomes: NDArray[np.bool_]) -> None:
    """A line of probabilities and a line of what held, bin by bin."""
    bins, error = reliability(probabilities, outcomes)
    print(f"{title}: n {len(outcomes)}, expected calibration error {error:.3f}")
    print("    said " + " ".join(f"{part.probability:5.2f}" for part in bins))
    print("    held " + " ".join(f"{part.held:5.2f}" for part in bins))
