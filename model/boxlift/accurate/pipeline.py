"""From the prompts of a frame to a decision on each: which box, which others, and by what evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from boxlift.accurate.evidence import Evidence, weigh
from boxlift.accurate.parameters import BOTTOM, HEIGHT, LENGTH, YAW, X, Z, to_boxes
from boxlift.accurate.polish import (
    SizePull,
    Target,
    Viewpoint,
    outline_distance,
    point_weights,
    polish,
)
from boxlift.accurate.proposals import distinct, find_clusters, lower_half, propose
from boxlift.accurate.view import Region, View, region_of
from boxlift.accurate.weights import EVIDENCE_WEIGHTS
from boxlift.camera import Floats
from boxlift.fit import FitProblem, FitSolution, fit_boxes
from boxlift.frame import Frame, LossTerms
from boxlift.overlap import bev_intersection
from boxlift.priors import SizePrior
from boxlift.settings import LabellerSettings, RepairSettings
from boxlift.stage_times import StageTimes

# Object points reach this much above the class's height, as roof racks and slopes do.
_ABOVE_M = 0.2
# What lies this close around a chosen box belongs to it.
_CLAIM_M = 0.05
# Points this close to a proposal are its object-LiDAR-points.
_FIT_REACH_M = 0.5
_FIT_POINTS = 3
# Points in the uppermost fifth are inside the outline seen from above (windows, roof).
_OUTLINE_SHARE = 0.8
_SCOUT_STEPS, _POLISH_STEPS = 3, 6
# Scouts look at every second point.
_SCOUT_STRIDE = 2
# Boxes may overlap by this share of the smaller one's area: prompts and sizes are not exact.
_MAY_OVERLAP = 0.05
_EXCLUSION_ROUNDS = 4
# Worse than any loss.
_NO_FIT = 1e3


@dataclass(frozen=True)
class Decision:
    """What was decided on one prompt.

    parameters: (B, 7) the hypotheses after fit and polish. energy: (B,) the lower, the likelier.
    losses: of each fit, None where there were too few points for one. used: points that it saw. chosen:
    the row of the box.
    """

    index: int
    region: Region
    size: SizePull
    parameters: Floats
    energy: Floats
    evidence: Evidence
    losses: tuple[LossTerms | None, ...]
    used: tuple[int, ...]
    chosen: int


@dataclass(frozen=True)
class _Scouted:
    """The hypotheses (B, 7) of one prompt that are worth a fit, the likeliest first, and their target."""

    index: int
    region: Region
    size: SizePull
    hypotheses: Floats
    target: Target


def decide(
    view: View, usable: Sequence[int], settings: LabellerSettings, times: StageTimes | None = None
) -> dict[int, Decision]:
    """Decisions by prompt number; a usable prompt without any hypothesis has none."""
    times = times or StageTimes()
    repairs = settings.repairs or RepairSettings()
    viewpoint = Viewpoint(
        view.frame.calibration.image_P_cam, view.frame.image_size_px, weight=float(repairs.edges)
    )
    with times.stage("scout"):
        scouted = _scout_all(view, usable, viewpoint, settings, repairs)
    if not scouted:
        return {}
    with times.stage("fit"):
        problems = _fit_problems(view, scouted, settings)
        fits = iter(
            fit_boxes(
                [problem for problem in problems if problem is not None],
                settings.fit,
                settings.loss,
                settings.points.sample_count,
            )
        )
        solutions = [None if problem is None else next(fits) for problem in problems]
    with times.stage("polish"):
        target = Target.joined([item.target for item in scouted])
        boxes = _place(scouted, target, solutions)
        if repairs.polish:
            boxes, _ = polish(boxes, target, [viewpoint], _POLISH_STEPS)
    with times.stage("evidence"):
        used = [0 if problem is None else len(problem.points_xz) for problem in problems]
        decisions = _weigh_all(view, scouted, boxes, solutions, used, repairs)
        if repairs.exclusion_weight > 0:
            decisions = _exclude(decisions, repairs.exclusion_weight)
    return {decision.index: decision for decision in decisions}


def _scout_all(
    view: View,
    usable: Sequence[int],
    viewpoint: Viewpoint,
    settings: LabellerSettings,
    repairs: RepairSettings,
) -> list[_Scouted]:
    """Hypotheses on every prompt, near to far: what the likeliest box explains is not offered again."""
    claimed = np.zeros(len(view.points_cam), dtype=np.bool_)
    scouted: list[_Scouted] = []
    for index in _near_to_far(view.frame, usable):
        found = _scout(view, index, claimed, viewpoint, settings, repairs)
        if found is None:
            continue
        scouted.append(found)
        if repairs.claim:
            claimed |= _explained(view, found.hypotheses[0])
    return scouted


def _near_to_far(frame: Frame, usable: Sequence[int]) -> list[int]:
    """The lower a prompt ends in the image, the nearer its object stands."""
    return sorted(usable, key=lambda index: -frame.prompts[index].box_px[3])


def _scout(
    view: View,
    index: int,
    claimed: NDArray[np.bool_],
    viewpoint: Viewpoint,
    settings: LabellerSettings,
    repairs: RepairSettings,
) -> _Scouted | None:
    """Hypotheses on one prompt from the points that no nearer object has claimed."""
    prior = settings.sizes[view.frame.prompts[index].category]
    size = size_pull(prior)
    height_m = float(size.lwh_m[2])
    region = region_of(view, index, claimed, height_m + _ABOVE_M)
    if len(region.inside) < settings.points.min_points:
        return None
    clusters = find_clusters(view, region, repairs)
    proposals = propose(view, region, clusters, size.lwh_m, settings.points.sample_count, repairs)
    if len(proposals) == 0:
        return None
    points_xz = view.points_cam[region.inside][:, [0, 2]]
    weights = point_weights(points_xz, settings.loss.density_radius_m)
    weights *= view.above_m[region.inside] < _OUTLINE_SHARE * height_m
    if repairs.polish:
        some = slice(None, None, _SCOUT_STRIDE)
        worth = weights[some] * _SCOUT_STRIDE
        on_ground = view.ground.is_known(proposals[:, X], proposals[:, Z])
        target = Target.of_one(points_xz[some], worth, region.box_px, size, proposals[:, BOTTOM], on_ground)
        proposals, _ = polish(proposals, target, [viewpoint], _SCOUT_STEPS)
    energy = weigh(view, region, proposals, size, use_edges=repairs.edges).energy(EVIDENCE_WEIGHTS)
    hypotheses = distinct(proposals[np.argsort(energy, kind="stable")])[: repairs.fits]
    x, z = hypotheses[:, X], hypotheses[:, Z]
    target = Target.of_one(
        points_xz, weights, region.box_px, size, view.ground.y_at(x, z), view.ground.is_known(x, z)
    )
    return _Scouted(index, region, size, hypotheses, target)


def size_pull(prior: SizePrior) -> SizePull:
    """Where sizes are pulled to: the class's typical size, its frozen one where it names none."""
    typical = prior.templates[0] if prior.templates else prior
    lwh = np.array([typical.length_m, typical.width_m, typical.height_m])
    return SizePull(lwh, lwh * np.array(prior.spread))


def _fit_problems(
    view: View, scouted: Sequence[_Scouted], settings: LabellerSettings
) -> list[FitProblem | None]:
    """The paper's fit near each hypothesis, size and heading frozen, on the points there; None without."""
    from_lidar = settings.loss.ray_origin == "lidar"
    origin_cam = view.sensor_cam if from_lidar else view.frame.calibration.camera_center_cam
    most = settings.points.sample_count
    problems: list[FitProblem | None] = []
    for item in scouted:
        length_m, width_m, _ = item.size.lwh_m
        inside_xz = view.points_cam[item.region.inside][:, [0, 2]]
        near = outline_distance(item.hypotheses, inside_xz) < _FIT_REACH_M
        for hypothesis, is_near in zip(item.hypotheses, near, strict=True):
            points_xz = lower_half(view, item.region.inside[is_near])
            problem = FitProblem(
                points_xz=points_xz[:: -(-len(points_xz) // most) or 1],
                length_m=float(length_m),
                width_m=float(width_m),
                rotation_y=float(hypothesis[YAW]),
                origin_xz=origin_cam[[0, 2]],
                start_xz=hypothesis[[X, Z]],
            )
            problems.append(problem if len(points_xz) >= _FIT_POINTS else None)
    return problems


def _place(scouted: Sequence[_Scouted], target: Target, solutions: Sequence[FitSolution | None]) -> Floats:
    """(B, 7) all hypotheses of the frame at the minima of their fits, on the ground, of frozen size."""
    boxes = np.concatenate([item.hypotheses for item in scouted])
    boxes[:, LENGTH : HEIGHT + 1] = target.lwh_m
    boxes[:, BOTTOM] = target.bottom_y
    for row, solution in enumerate(solutions):
        if solution is not None:
            boxes[row, [X, Z]] = solution.center_xz
    return boxes


def _weigh_all(
    view: View,
    scouted: Sequence[_Scouted],
    boxes: Floats,
    solutions: Sequence[FitSolution | None],
    used: Sequence[int],
    repairs: RepairSettings,
) -> list[Decision]:
    """The evidence on every hypothesis, and the likeliest of each prompt."""
    decisions = []
    start = 0
    for item in scouted:
        rows = slice(start, start + len(item.hypotheses))
        start = rows.stop
        evidence = weigh(view, item.region, boxes[rows], item.size, use_edges=repairs.edges)
        losses = tuple(None if fit is None else fit.losses for fit in solutions[rows])
        energy = evidence.energy(EVIDENCE_WEIGHTS)
        if repairs.choose == "loss":
            energy = np.array([_NO_FIT if loss is None else loss.total for loss in losses])
        decisions.append(
            Decision(
                index=item.index,
                region=item.region,
                size=item.size,
                parameters=boxes[rows],
                energy=energy,
                evidence=evidence,
                losses=losses,
                used=tuple(used[rows]),
                chosen=int(energy.argmin()),
            )
        )
    return decisions


def _explained(view: View, box: Floats) -> NDArray[np.bool_]:
    """(N,) the points that a box (7,) explains."""
    beyond = outline_distance(box[None], view.points_cam[:, [0, 2]])[0]
    explained: NDArray[np.bool_] = (beyond < _CLAIM_M) & (view.above_m < box[HEIGHT] + _ABOVE_M)
    return explained


def _exclude(decisions: list[Decision], weight: float) -> list[Decision]:
    """No two objects in one place: each in turn takes its likeliest box, overlaps with the others counted."""
    chosen = [decision.chosen for decision in decisions]
    for _ in range(_EXCLUSION_ROUNDS):
        before = list(chosen)
        for i, decision in enumerate(decisions):
            others = np.array([decisions[j].parameters[chosen[j]] for j in range(len(decisions)) if j != i])
            if len(others) == 0:
                continue
            overlap = (_overlap_shares(decision.parameters, others) - _MAY_OVERLAP).clip(0).sum(1)
            chosen[i] = int((decision.energy + weight * overlap).argmin())
        if chosen == before:
            break
    return [replace(decision, chosen=row) for decision, row in zip(decisions, chosen, strict=True)]


def _overlap_shares(parameters: Floats, others: Floats) -> Floats:
    """(B, 7) and (O, 7) -> (B, O) overlaps as shares of the smaller box's area, seen from above."""
    a, b = to_boxes(parameters), to_boxes(others)
    rows, columns = np.repeat(np.arange(len(a)), len(b)), np.tile(np.arange(len(b)), len(a))
    smaller = np.minimum(a.length_m[rows] * a.width_m[rows], b.length_m[columns] * b.width_m[columns])
    shares: Floats = (bev_intersection(a[rows], b[columns]) / smaller).reshape(len(a), len(b))
    return shares
