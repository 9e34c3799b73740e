"""From the prompts of a frame to a decision on each: which box, which others, and by what evidence."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from boxlift.accurate.evidence import Evidence, weigh
from boxlift.accurate.parameters import BOTTOM, HEIGHT, LENGTH, YAW, X, Z, to_boxes
from boxlift.accurate.polish import SizePull, Target, outline_distance, point_weights, polish
from boxlift.accurate.proposals import find_clusters, lower_half, propose
from boxlift.accurate.view import Region, View, region_of
from boxlift.accurate.weights import EVIDENCE_WEIGHTS
from boxlift.camera import Floats
from boxlift.fit import FitProblem, FitSolution, fit_boxes
from boxlift.frame import Frame, LossTerms
from boxlift.ground import Ground
from boxlift.overlap import bev_intersection
from boxlift.priors import SizePrior, SizeTemplate
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
_DENSITY_RADIUS_M = 0.4
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
    parameters: Floats
    energy: Floats
    evidence: Evidence
    losses: tuple[LossTerms | None, ...]
    chosen: int


def decide(frame: Frame, view: View, usable: list[int], settings: LabellerSettings) -> dict[int, Decision]:
    """Decisions by prompt number; a usable prompt without any hypothesis has none."""
    assert settings.repairs is not None
    repairs = settings.repairs
    claimed = np.zeros(len(view.points_cam), dtype=np.bool_)
    decisions: list[Decision] = []
    for index in _near_to_far(frame, usable):
        decision = _decide_one(view, index, claimed, settings, repairs)
        if decision is None:
            continue
        decisions.append(decision)
        if repairs.claim:
            claimed |= _explained(view, decision.parameters[decision.chosen])
    if repairs.exclusion_weight > 0:
        decisions = _exclude(decisions, repairs.exclusion_weight)
    return {decision.index: decision for decision in decisions}


def _near_to_far(frame: Frame, usable: list[int]) -> list[int]:
    """The lower a prompt ends in the image, the nearer its object stands."""
    return sorted(usable, key=lambda index: -frame.prompts[index].box_px[3])


def _decide_one(
    view: View, index: int, claimed: NDArray[np.bool_], settings: LabellerSettings, repairs: RepairSettings
) -> Decision | None:
    frame = view.frame
    prior = settings.sizes[frame.prompts[index].category]
    pull = size_pull(prior, fixed=repairs.size == "fixed")
    length_m, width_m, height_m = pull.lwh_m
    region = region_of(view, index, claimed, float(height_m) + _ABOVE_M)
    if len(region.inside) < settings.points.min_points:
        return None
    clusters = find_clusters(view, region, repairs)
    size = SizeTemplate(
        name="frozen", height_m=height_m, width_m=width_m, length_m=length_m, source="settings"
    )
    proposals = propose(view, region, clusters, size, settings.points.sample_count, repairs)
    if len(proposals) == 0:
        return None

    points_xz = view.points_cam[region.inside][:, [0, 2]]
    weights = point_weights(points_xz, _DENSITY_RADIUS_M)
    use_edges = np.full(4, repairs.edges)
    target = Target(
        points_xz=points_xz,
        weights=weights * (view.above_m[region.inside] < _OUTLINE_SHARE * height_m),
        box_px=region.box_px,
        use_edges=use_edges,
        image_size_px=frame.image_size_px,
        calibration=frame.calibration,
        size=pull,
        bottom_y=proposals[:, BOTTOM],
        free=_SIZE_FIXED if repairs.size == "fixed" else Target.free,
    )
    scouted = polish(proposals, target, _SCOUT_STEPS) if repairs.polish else proposals
    seen = weigh(view, region, scouted, pull, weights, use_edges)
    order = np.argsort(seen.energy(EVIDENCE_WEIGHTS), kind="stable")[: repairs.fits]
    frozen = scouted[order]
    frozen[:, LENGTH : HEIGHT + 1] = pull.lwh_m
    fitted, losses = _fit(view, region, frozen, settings)
    fitted[:, BOTTOM] = view.ground.y_at(fitted[:, X], fitted[:, Z])
    if repairs.polish:
        fitted = polish(fitted, replace(target, bottom_y=fitted[:, BOTTOM]), _POLISH_STEPS)
    evidence = weigh(view, region, fitted, pull, weights, use_edges)
    energy = evidence.energy(EVIDENCE_WEIGHTS)
    if repairs.choose == "loss":
        energy = np.array([np.inf if loss is None else loss.total for loss in losses])
    return Decision(index, region, fitted, energy, evidence, losses, int(energy.argmin()))


def size_pull(prior: SizePrior, *, fixed: bool) -> SizePull:
    """Where sizes are pulled to: the class's typical size, or its frozen one where sizes are fixed."""
    typical = prior if fixed or not prior.templates else prior.templates[0]
    lwh = np.array([typical.length_m, typical.width_m, typical.height_m])
    return SizePull(lwh, lwh * np.array(prior.spread))


def _fit(
    view: View, region: Region, frozen: Floats, settings: LabellerSettings
) -> tuple[Floats, tuple[LossTerms | None, ...]]:
    """Minimum of the paper's losses for each box (B, 7), size and heading frozen, on the points around it."""
    inside_xz = view.points_cam[region.inside][:, [0, 2]]
    near = outline_distance(frozen, inside_xz) < _FIT_REACH_M
    points = [lower_half(view, region.inside[rows]) for rows in near]
    points = [some[:: max(1, -(-len(some) // settings.points.sample_count))] for some in points]
    fittable = [row for row, some in enumerate(points) if len(some) >= _FIT_POINTS]
    origin_cam = (
        view.sensor_cam if settings.loss.ray_origin == "lidar" else view.frame.calibration.camera_center_cam
    )
    problems = [
        FitProblem(
            points_xz=points[row],
            length_m=float(frozen[row, LENGTH]),
            width_m=float(frozen[row, LENGTH + 1]),
            rotation_y=float(frozen[row, YAW]),
            origin_xz=origin_cam[[0, 2]],
        )
        for row in fittable
    ]
    solutions = fit_boxes(problems, settings.fit, settings.loss, settings.points.sample_count)
    by_row: dict[int, FitSolution] = dict(zip(fittable, solutions, strict=True))
    fitted = frozen.copy()
    for row, solution in by_row.items():
        fitted[row, [X, Z]] = solution.center_xz
    losses = tuple(by_row[row].losses if row in by_row else None for row in range(len(frozen)))
    return fitted, losses


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
