"""The fit of `ablation.py` where heading or size may move as well: Adam on the same losses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from boxlift import Boxes3D, Frame, FrameLabels, LabellerSettings, ObjectLabel
from boxlift.camera import Floats
from boxlift.consistency import agree_with_prompts
from boxlift.fit import FitProblem
from boxlift.losses import BevBoxes, balanced_loss, point_density
from boxlift.settings import LossSettings

# Of Adam, ours: of the rates 0.01, 0.02 and 0.05 this one ends lowest on the full loss.
_STEPS, _LEARNING_RATE = 300, 0.05
_HEADINGS = 8


@dataclass(frozen=True)
class Freed:
    """What moves besides the centre.

    heading_read: the heading starts as it was read from the points. Else there are eight descents, evenly
    turned from a random first heading, and the one of lowest loss counts.
    """

    size: bool = False
    heading: bool = False
    heading_read: bool = True


def freed_labels(
    frames: Sequence[Frame],
    frozen: Sequence[FrameLabels],
    hypotheses: Sequence[Sequence[FitProblem]],
    settings: LabellerSettings,
    freed: Freed,
    category: str,
) -> list[FrameLabels]:
    """The labeller's labels, the boxes of one class fitted anew by a descent, and set on y again.

    hypotheses: per frame the labeller's fit problems, equally many per object, the chosen one first.
    """
    problems = [
        of_frame[index * len(of_frame) // len(labels.fitted)]
        for of_frame, labels in zip(hypotheses, frozen, strict=True)
        for index, label in enumerate(labels.fitted)
        if label.prompt.category == category
    ]
    states = iter(descend(problems, settings.loss, freed))

    def refitted(label: ObjectLabel, frame: Frame) -> ObjectLabel:
        if label.box is None or label.prompt.category != category:
            return label
        x, z, rotation_y, length_m, width_m = next(states)[:, None]
        center = np.stack([x, label.box.center_cam[:, 1], z], axis=1)
        box = Boxes3D(center, length_m, width_m, label.box.height_m, rotation_y)
        prompt_px = np.array([label.prompt.box_px])
        box = agree_with_prompts(box, prompt_px, frame.calibration, frame.image_size_px, settings.consistency)
        return replace(label, box=box)

    return [
        replace(labels, objects=tuple(refitted(label, frame) for label in labels.objects))
        for frame, labels in zip(frames, frozen, strict=True)
    ]


def descend(problems: Sequence[FitProblem], loss: LossSettings, freed: Freed) -> Floats:
    """x, z, rotation_y, length, width (N, 5) of lowest loss on Adam's way from the mean of the points."""
    most = max(len(problem.points_xz) for problem in problems)
    points, valid = torch.zeros(len(problems), most, 2), torch.zeros(len(problems), most, dtype=torch.bool)
    for row, problem in enumerate(problems):
        points[row, : len(problem.points_xz)] = torch.from_numpy(problem.points_xz)
        valid[row, : len(problem.points_xz)] = True
    origin = torch.from_numpy(np.stack([problem.origin_xz for problem in problems])).float()
    density = point_density(points, valid, loss.density_radius_m)

    headings = np.array([[problem.rotation_y for problem in problems]])
    if not freed.heading_read:
        first = np.random.default_rng(0).uniform(0, np.pi, len(problems))
        headings = first + np.arange(_HEADINGS)[:, None] * np.pi / _HEADINGS
    mean = np.stack([problem.points_xz.mean(axis=0) for problem in problems])
    log_size = np.log([[problem.length_m, problem.width_m] for problem in problems])
    columns = np.broadcast_arrays(*mean.T, headings, *log_size.T)
    start = torch.from_numpy(np.stack(columns, axis=-1)).float()  # (starts, N, 5)

    moves = torch.tensor([1, 1, freed.heading, freed.size, freed.size])
    moved = torch.zeros_like(start, requires_grad=True)
    optimiser = torch.optim.Adam([moved], lr=_LEARNING_RATE)
    best, lowest = start, torch.full(start.shape[:2], torch.inf)
    for _ in range(_STEPS):
        state = start + moves * moved
        boxes = BevBoxes(state[..., :2], state[..., 3].exp(), state[..., 4].exp(), state[..., 2])
        total = balanced_loss(points, valid, boxes, origin, loss, density)
        (moved.grad,) = torch.autograd.grad(total.sum(), [moved])
        best = torch.where((total < lowest)[..., None], state, best).detach()
        lowest = torch.minimum(total, lowest).detach()
        optimiser.step()
    found = best[lowest.argmin(dim=0), torch.arange(len(problems))]
    found[:, 3:] = found[:, 3:].exp()
    solutions: Floats = found.double().numpy()
    return solutions
