"""From the prompts of a frame to a decision on each: which box, which others, and by what evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from boxlift.accurate.evidence import Evidence, weigh
from boxlift.accurate.parameters import BOTTOM, HEIGHT, LENGTH, YAW, X, Z, to_boxes
from boxlift.accurate.polish import (
    Freedom,
    SizePull,
    Target,
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

# Object points reach this much above the class's height, as roof racks and slopes do.
_ABOVE_M = 0.2
# What lies this close around a chosen box belongs to it.
_CLAIM_M = 0.15
# Points this close to a proposal are its object-LiDAR-points.
_FIT_REACH_M = 0.5
_FIT_POINTS = 3
# Points in the uppermost fifth are inside the outline seen from above (windows, roof).
_OUTLINE_SHARE = 0.8
_SCOUT_STEPS, _POLISH_STEPS = 3, 8
# Boxes may overlap by this share of the smaller one's area: prompts and sizes are not exact.
_MAY_OVERLAP = 0.05
_EXCLUSION_ROUNDS = 4
_SIZE_FIXED = (X, Z, YAW, BOTTOM)


@dataclass(frozen=True)
class Decision:
    """What was decided on one prompt.

    parameters: (B, 7) the hypotheses after fit and polish. energy: (B,) the lower, the likelier.
    losses: of each fit, None where there were too few points for one. chosen: the row of the box.
    """

    index: int
    region: Region
    size: SizePull
    parameters: Floats
    energy: Floats
    evidence: Evidence
    losses: tuple[LossTerms | None, ...]
    chosen: int


@dataclass(frozen=True)
class _Scouted:
    """The hypotheses (B, 7) of one prompt that are worth a fit, the likeliest first, and their target."""

    index: int
    region: Region
    size: SizePull
    hypotheses: Floats
    target: Target


def decide(view: View, usable: Sequence[int], settings: LabellerSettings) -> dict[int, Decision]:
    """Decisions by prompt number; a usable prompt without any hypothesis has none."""
    assert settings.repairs is not None
    repairs = settings.repairs
    freedom = Freedom(
        view.frame.calibration,
        view.frame.image_size_px,
        use_edges=repairs.edges,
        free=_SIZE_FIXED if repairs.size == "fixed" else Freedom.free,
    )
    claimed = np.zeros(len(view.points_cam), dtype=np.bool_)
    scouted: list[_Scouted] = []
    for index in _near_to_far(view.frame, usable):
        found = _scout(view, index, claimed, freedom, settings, repairs)
        if found is None:
            continue
        scouted.append(found)
        if repairs.claim:
            claimed |= _explained(view, found.hypotheses[0])
    if not scouted:
        return {}
    decisions = _fit_and_weigh(view, scouted, freedom, settings, repairs)
    if repairs.exclusion_weight > 0:
        decisions = _exclude(decisions, repairs.exclusion_weight)
    return {decision.index: decision for decision in decisions}


def _near_to_far(frame: Frame, usable: Sequence[int]) -> list[int]:
    """The lower a prompt ends in the image, the nearer its object stands."""
    return sorted(usable, key=lambda index: -frame.prompts[index].box_px[3])


def _scout(
    view: View,
    index: int,
    claimed: NDArray[np.bool_],
    freedom: Freedom,
    settings: LabellerSettings,
    repairs: RepairSettings,
) -> _Scouted | None:
    """Hypotheses on one prompt from the points that no nearer object has claimed."""
    prior = settings.sizes[view.frame.prompts[index].category]
    size = size_pull(prior, fixed=repairs.size == "fixed")
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
    target = Target.of_one(len(proposals), points_xz, weights, region.box_px, size, proposals[:, BOTTOM])
    if repairs.polish:
        proposals = polish(proposals, target, freedom, _SCOUT_STEPS)
    energy = weigh(view, region, proposals, size, use_edges=repairs.edges).energy(EVIDENCE_WEIGHTS)
    hypotheses = distinct(proposals[np.argsort(energy, kind="stable")])[: repairs.fits]
    ground_y = view.ground.y_at(hypotheses[:, X], hypotheses[:, Z])
    target = Target.of_one(len(hypotheses), points_xz, weights, region.box_px, size, ground_y)
    return _Scouted(index, region, size, hypotheses, target)


def size_pull(prior: SizePrior, *, fixed: bool) -> SizePull:
    """Where sizes are pulled to: the class's typical size, or its frozen one where sizes are fixed."""
    typical = prior if fixed or not prior.templates else prior.templates[0]
    lwh = np.array([typical.length_m, typical.width_m, typical.height_m])
    return SizePull(lwh, lwh * np.array(prior.spread))


def _fit_and_weigh(
    view: View,
    scouted: Sequence[_Scouted],
    freedom: Freedom,
    settings: LabellerSettings,
    repairs: RepairSettings,
) -> list[Decision]:
    """The paper's fit of every hypothesis of the frame, the polish of all, and the evidence on each."""
    fits = _fit(view, scouted, settings)
    fitted = np.concatenate([item.hypotheses for item in scouted])
    target = Target.joined([item.target for item in scouted])
    fitted[:, LENGTH : HEIGHT + 1] = target.lwh_m
    fitted[:, BOTTOM] = target.bottom_y
    for row, fit in enumerate(fits):
        if fit is not None:
            fitted[row, [X, Z]] = fit.center_xz
    if repairs.polish:
        fitted = polish(fitted, target, freedom, _POLISH_STEPS)
    decisions = []
    start = 0
    for item in scouted:
        rows = slice(start, start + len(item.hypotheses))
        start = rows.stop
        evidence = weigh(view, item.region, fitted[rows], item.size, use_edges=repairs.edges)
        losses = tuple(None if fit is None else fit.losses for fit in fits[rows])
        energy = evidence.energy(EVIDENCE_WEIGHTS)
        if repairs.choose == "loss":
            energy = np.array([np.inf if loss is None else loss.total for loss in losses])
        chosen = int(energy.argmin())
        decisions.append(
            Decision(item.index, item.region, item.size, fitted[rows], energy, evidence, losses, chosen)
        )
    return decisions


def _fit(view: View, scouted: Sequence[_Scouted], settings: LabellerSettings) -> list[FitSolution | None]:
    """The minimum of the paper's losses near each hypothesis, size and heading frozen, on the points there.

    None where fewer than three points are near.
    """
    from_lidar = settings.loss.ray_origin == "lidar"
    origin_cam = view.sensor_cam if from_lidar else view.frame.calibration.camera_center_cam
    count = settings.points.sample_count
    problems: list[FitProblem | None] = []
    for item in scouted:
        length_m, width_m, _ = item.size.lwh_m
        inside_xz = view.points_cam[item.region.inside][:, [0, 2]]
        near = outline_distance(item.hypotheses, inside_xz) < _FIT_REACH_M
        for hypothesis, is_near in zip(item.hypotheses, near, strict=True):
            points_xz = lower_half(view, item.region.inside[is_near])
            problem = FitProblem(
                points_xz=points_xz[:: -(-len(points_xz) // count) or 1],
                length_m=float(length_m),
                width_m=float(width_m),
                rotation_y=float(hypothesis[YAW]),
                origin_xz=origin_cam[[0, 2]],
                start_xz=hypothesis[[X, Z]],
            )
            problems.append(problem if len(points_xz) >= _FIT_POINTS else None)
    solved = iter(fit_boxes([p for p in problems if p is not None], settings.fit, settings.loss, count))
    return [None if problem is None else next(solved) for problem in problems]


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
