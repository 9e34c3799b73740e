"""Fit the weights of the evidence that chooses between hypotheses, on generated scenes only.

    python benchmarks/evidence_weights.py [--frames 30]

Every usable prompt is a choice between its hypotheses (a conditional logit: McFadden, 1974): the weights
maximise the expected 3D IoU, with a bonus above .5 and .7. Prints the table of model/boxlift/accurate/
weights.py. Generated truth is exact, and no labelled real frame has a part in it.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np
import torch
from torch import Tensor

from boxlift.accurate.evidence import Evidence
from boxlift.accurate.parameters import to_boxes
from boxlift.accurate.pipeline import decide
from boxlift.accurate.view import View
from boxlift.camera import Floats
from boxlift.datasets.generated import RIGS, GeneratedFrame, SceneSettings, generate
from boxlift.formats.kitti_label import KittiObject, boxes3d_of
from boxlift.overlap import iou_3d
from boxlift.settings import ACCURATE, LabellerSettings

NAMES = tuple(field.name for field in fields(Evidence))
# Seeds of the benchmarks begin at 0 and of the tests below 100; these are of neither.
_FIRST_SEED = 5_000
_DENSE = SceneSettings(parked=2.0, moving=1.5, people=1.5)
_MANY_FITS = 12
_STEPS, _RATE, _RIDGE = 400, 0.05, 1e-3
# What a weight may be: an error cannot speak for a box, nor points on it against it. Rays that fall short
# or miss say nothing of their own, as what hides an object need not have a prompt.
_AGAINST = (
    "sides",
    "vertical",
    "length",
    "width",
    "height",
    "ground",
    "through",
    "behind",
    "spill",
    "misfit",
)
_FOR = ("on", "span", "contained", "count")


@dataclass(frozen=True)
class Choice:
    """One prompt: evidence (B, F) on its hypotheses and their 3D IoU (B,) with the truth."""

    truth: KittiObject
    evidence: Floats
    iou: Floats


def choices_of(generated: GeneratedFrame, settings: LabellerSettings) -> Iterator[Choice]:
    """The choices that the frame's prompts pose."""
    frame = generated.frame
    decisions = decide(View.of(frame, settings.ground), range(len(frame.prompts)), settings)
    for index, decision in decisions.items():
        boxes = to_boxes(decision.parameters)
        truth = boxes3d_of([generated.truth[index]] * len(boxes))
        yield Choice(generated.truth[index], decision.evidence.matrix(), iou_3d(truth, boxes))


def fit_weights(choices: list[Choice]) -> Floats:
    """(F,) weights that make the expected value of the chosen box largest."""
    most = max(len(choice.iou) for choice in choices)
    evidence = np.zeros((len(choices), most, len(NAMES)))
    value = np.zeros((len(choices), most))
    offered = np.zeros((len(choices), most), dtype=np.bool_)
    for row, choice in enumerate(choices):
        count = len(choice.iou)
        evidence[row, :count] = choice.evidence
        value[row, :count] = choice.iou + 0.5 * (choice.iou > 0.5) + 0.5 * (choice.iou > 0.7)
        offered[row, :count] = True
    scale = evidence[offered].std(axis=0) + 1e-6
    scaled, values, mask = torch.tensor(evidence / scale), torch.tensor(value), torch.tensor(offered)
    weights: Tensor = torch.zeros(len(NAMES), dtype=torch.float64, requires_grad=True)
    low = torch.tensor([-torch.inf if name in _FOR else 0.0 for name in NAMES], dtype=torch.float64)
    high = torch.tensor([torch.inf if name in _AGAINST else 0.0 for name in NAMES], dtype=torch.float64)
    optimiser = torch.optim.Adam([weights], lr=_RATE)
    for _ in range(_STEPS):
        energy = (scaled @ weights).masked_fill(~mask, torch.inf)
        expected = ((-energy).softmax(-1) * values).sum(-1).mean()
        loss = _RIDGE * weights.square().sum() - expected
        (weights.grad,) = torch.autograd.grad(loss, [weights])
        optimiser.step()
        with torch.no_grad():
            weights.clamp_(low, high)
    fitted: Floats = weights.detach().numpy() / scale
    return fitted


def main() -> None:
    """Collect, fit, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--frames", type=int, default=30, help="frames per rig and kind of scene")
    count = parser.parse_args().frames
    torch.set_num_threads(1)
    repairs = ACCURATE.repairs
    assert repairs is not None
    settings = ACCURATE.model_copy(update={"repairs": repairs.model_copy(update={"fits": _MANY_FITS})})
    choices = [
        choice
        for rig in ("kitti", "roof32")
        for kind, scene in enumerate((SceneSettings(), _DENSE))
        for seed in range(count)
        for choice in choices_of(generate(_FIRST_SEED + 1_000 * kind + seed, RIGS[rig], scene), settings)
        if choice.iou.max() > 0.3
    ]
    weights = fit_weights(choices)
    print(f"# {len(choices)} choices")
    print("EVIDENCE_WEIGHTS = {")
    for name, weight in zip(NAMES, weights, strict=True):
        if weight:
            print(f'    "{name}": {weight:.2f},')
    print("}")


if __name__ == "__main__":
    main()
