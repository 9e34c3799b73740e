"""Fit the calibrated probabilities of the preset accurate, on generated scenes only.

    python benchmarks/calibration.py [--frames 60]

Logistic regression of "3D IoU above .5" (and .7) on the evidence of the chosen boxes, with the prompts of
the generated labels. Prints the table of model/boxlift/accurate/weights.py. How reliable the probabilities
are on real drives, none of which had a part in this, is in benchmarks/accurate.py.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np
import torch

from boxlift.accurate.parameters import to_boxes
from boxlift.accurate.pipeline import decide
from boxlift.accurate.probability import FEATURES, features_of
from boxlift.accurate.view import View
from boxlift.camera import Floats
from boxlift.datasets.generated import RIGS, GeneratedFrame, generate
from boxlift.formats.kitti_label import boxes3d_of
from boxlift.overlap import iou_3d
from boxlift.settings import ACCURATE

# Seeds of neither the tests nor other benchmarks.
_FIRST_SEED = 8_000
_STEPS, _RATE, _RIDGE = 4_000, 0.02, 1e-3


def outcomes_of(generated: GeneratedFrame) -> Iterator[tuple[Floats, float]]:
    """Features (F,) and 3D IoU of every box that is chosen."""
    frame = generated.frame
    view = View.of(frame, ACCURATE.ground)
    for index, decision in decide(view, range(len(frame.prompts)), ACCURATE).items():
        chosen = to_boxes(decision.parameters[[decision.chosen]])
        truth = boxes3d_of([generated.truth[index]])
        yield features_of(decision), float(iou_3d(truth, chosen)[0])


def fit_logistic(features: Floats, outcome: Floats) -> Floats:
    """(N, F) and (N,) of 0 and 1 -> (F,) weights; the first feature is the constant 1."""
    mean, deviation = features[:, 1:].mean(axis=0), features[:, 1:].std(axis=0) + 1e-6
    scaled = torch.tensor(np.column_stack([features[:, 0], (features[:, 1:] - mean) / deviation]))
    wanted = torch.tensor(outcome)
    weights = torch.zeros(features.shape[1], dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.Adam([weights], lr=_RATE)
    for _ in range(_STEPS):
        loss = torch.nn.functional.binary_cross_entropy_with_logits(scaled @ weights, wanted)
        loss = loss + _RIDGE * weights[1:].square().sum()
        (weights.grad,) = torch.autograd.grad(loss, [weights])
        optimiser.step()
    fitted = weights.detach().numpy()
    slopes = fitted[1:] / deviation
    return np.array([fitted[0] - slopes @ mean, *slopes])


def main() -> None:
    """Label, fit, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--frames", type=int, default=60, help="frames per rig")
    count = parser.parse_args().frames
    torch.set_num_threads(1)
    outcomes = [
        outcome
        for rig in ("kitti", "roof32", "far_apart")
        for seed in range(count)
        for outcome in outcomes_of(generate(_FIRST_SEED + seed, RIGS[rig]))
    ]
    features, iou = np.array([row for row, _ in outcomes]), np.array([value for _, value in outcomes])
    print(f"# {len(outcomes)} boxes; in the order of {', '.join(FEATURES)}")
    print("PROBABILITY_WEIGHTS = {")
    for threshold in (0.5, 0.7):
        weights = fit_logistic(features, (iou > threshold).astype(np.float64))
        print(f"    {threshold}: ({', '.join(f'{weight:.2f}' for weight in weights)}),")
    print("}")


if __name__ == "__main__":
    main()
