"""What verdicts teach: how often flags and scores were right, and scores calibrated anew by them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from boxlift.camera import Floats
from boxlift.corrections.correction import Opinion, Verdict
from boxlift.errors import OptionsError
from boxlift.formats.details import ObjectDetails, boxes3d_of_details
from boxlift.overlap import iou_3d

# What the score promises: that the 3D IoU with the right box exceeds it.
_RIGHT_IOU = 0.5
_LEAST_BOXES = 20
# Standard deviations of slope and offset around "the scores are right": a few verdicts move little.
_PRIOR_SLOPE, _PRIOR_OFFSET = 0.5, 1.0
_NEWTON_STEPS = 100
_SMALLEST_STEP = 1e-9
_EXTREME = 1e-4


@dataclass(frozen=True)
class Lesson:
    """A box that somebody judged: the machine's score and flags, and whether it was right."""

    score: float
    flags: tuple[str, ...]
    right: bool


@dataclass(frozen=True)
class Share:
    """Boxes of one kind, how many of them were right, and the mean of their scores."""

    name: str
    boxes: int
    right: int
    mean_score: float


@dataclass(frozen=True)
class Recalibration:
    """score -> logistic(slope * logit(score) + offset)."""

    slope: float
    offset: float

    def __call__(self, score: float) -> float:
        """The score as the verdicts have it."""
        return float(_logistic(self.slope * _logits([score]) + self.offset)[0])


def lesson_of(item: ObjectDetails, opinion: Opinion) -> Lesson | None:
    """What an opinion says of the machine's box; None where there is none of either.

    A box is right where it was accepted, or corrected by so little (same class) that the IoU stays above .5.
    """
    if item.box is None or opinion.verdict is Verdict.OPEN:
        return None
    right = opinion.verdict is Verdict.ACCEPTED
    if opinion.box is not None and opinion.category == item.category:
        boxes = boxes3d_of_details([item.box]), boxes3d_of_details([opinion.box])
        right = float(iou_3d(*boxes)[0]) > _RIGHT_IOU
    return Lesson(item.score, item.flags, right)


def shares_by_flag(lessons: Sequence[Lesson]) -> list[Share]:
    """For every flag the boxes that have it, most first; then those without any."""
    flags = {flag for lesson in lessons for flag in lesson.flags}
    kinds = [(flag, [each for each in lessons if flag in each.flags]) for flag in sorted(flags)]
    shares = [_share(flag.replace("_", " "), here) for flag, here in kinds]
    bare = [each for each in lessons if not each.flags]
    return sorted(shares, key=lambda share: -share.boxes) + ([_share("no flag", bare)] if bare else [])


def shares_by_score(lessons: Sequence[Lesson]) -> list[Share]:
    """Boxes by the tenth that their score is in."""
    tenths = [(at, [each for each in lessons if min(int(10 * each.score), 9) == at]) for at in range(10)]
    return [_share(f"score .{at}", here) for at, here in tenths if here]


def recalibrated(lessons: Sequence[Lesson]) -> Recalibration:
    """The calibration that verdicts and the score as it is together speak for (MAP, damped Newton steps).

    Platt scaling of the score's logit (Platt, 1999), with a normal prior around slope 1 and offset 0.
    Raises OptionsError with fewer than 20 judged boxes, or where all were right or all wrong.
    """
    right = sum(each.right for each in lessons)
    if len(lessons) < _LEAST_BOXES or right in (0, len(lessons)):
        raise OptionsError(
            "rescore",
            f"{len(lessons)} boxes were judged, {right} of them right.",
            f"Review at least {_LEAST_BOXES}, right and wrong ones among them.",
        )
    features = np.stack([_logits(each.score for each in lessons), np.ones(len(lessons))], axis=1)
    target = np.array([each.right for each in lessons], dtype=np.float64)
    prior = np.array([1.0, 0.0])
    precision = np.diag([1 / _PRIOR_SLOPE**2, 1 / _PRIOR_OFFSET**2])
    signs = 2 * target - 1

    def loss(weights: Floats) -> float:
        off = weights - prior
        return float(np.logaddexp(0, -signs * (features @ weights)).sum() + off @ precision @ off / 2)

    weights = prior.copy()
    for _ in range(_NEWTON_STEPS):
        said = _logistic(features @ weights)
        gradient = features.T @ (said - target) + precision @ (weights - prior)
        curvature = (features * (said * (1 - said))[:, None]).T @ features + precision
        step = np.linalg.solve(curvature, gradient)
        # Where logits are large, a whole step may lead far beyond the minimum.
        while loss(weights - step) > loss(weights) and float(np.abs(step).max()) > _SMALLEST_STEP:
            step = step / 2
        weights = weights - step
        if float(np.abs(step).max()) <= _SMALLEST_STEP:
            break
    return Recalibration(float(weights[0]), float(weights[1]))


def _share(name: str, lessons: Sequence[Lesson]) -> Share:
    mean = sum(each.score for each in lessons) / len(lessons)
    return Share(name, len(lessons), sum(each.right for each in lessons), mean)


def _logits(scores: Iterable[float]) -> Floats:
    kept = [min(max(score, _EXTREME), 1 - _EXTREME) for score in scores]
    return np.array([math.log(each / (1 - each)) for each in kept])


def _logistic(values: Floats) -> Floats:
    # The hyperbolic tangent is the logistic that cannot overflow.
    shares: Floats = (1 + np.tanh(values / 2)) / 2
    return shares
