"""A frame's labels by the preset `accurate`: decisions told as boxes, sentences, scores and flags."""

from __future__ import annotations

import numpy as np

from boxlift.accurate.parameters import HEIGHT, LENGTH, WIDTH, X, Z, to_box_frame, to_boxes
from boxlift.accurate.pipeline import Decision, decide
from boxlift.accurate.probability import probability
from boxlift.accurate.view import View, region_of
from boxlift.accurate.weights import EVIDENCE_WEIGHTS
from boxlift.boxes import Boxes3D
from boxlift.camera import Floats
from boxlift.confidence import share_of
from boxlift.frame import Frame, Hypothesis, ObjectLabel, PointCounts, Result
from boxlift.heading import facing_away
from boxlift.object_points import UnusablePrompt, check_prompt
from boxlift.settings import LabellerSettings
from boxlift.stage_times import StageTimes

_FEW_POINTS = 30
# More than this share of the points in and around a box just outside it: something stands against it.
_TOUCHING_SPILL = 0.1
# Below this probability of an IoU of .5 there is no object: a false detection, or one that nothing shows.
_NO_OBJECT = 0.02
# Sides of which the points show less than this share say nothing of the size.
_SEEN_SHARE = 0.6


def label_accurately(frame: Frame, settings: LabellerSettings, times: StageTimes) -> tuple[ObjectLabel, ...]:
    """Every prompt of a frame, in their order: a box, or the sentence why there is none."""
    with times.stage("ground"):
        view = View.of(frame, settings.ground)
    unusable = {
        index: problem
        for index, prompt in enumerate(frame.prompts)
        if (problem := check_prompt(prompt, index, frame.image_size_px, settings.sizes))
    }
    usable = [index for index in range(len(frame.prompts)) if index not in unusable]
    decisions = decide(view, usable, settings, times)
    with times.stage("confidence"):
        return tuple(
            _refused(frame, unusable[index])
            if index in unusable
            else _told(view, decisions[index], settings)
            if index in decisions
            else _without_points(view, index, settings)
            for index in range(len(frame.prompts))
        )


def _refused(frame: Frame, problem: UnusablePrompt) -> ObjectLabel:
    index = problem.prompt_index
    return ObjectLabel(index, frame.prompts[index], problem.result, problem.sentence)


def _without_points(view: View, index: int, settings: LabellerSettings) -> ObjectLabel:
    """A prompt in which too few points are left, all told: those of nearer objects were not counted."""
    frame = view.frame
    prompt = frame.prompts[index]
    nobody = np.zeros(len(view.points_cam), dtype=np.bool_)
    region = region_of(view, index, nobody, settings.sizes[prompt.category].height_m)
    ids = frame.instance_ids
    if ids is not None and not (ids == index + 1).any():
        return ObjectLabel(index, prompt, Result.EMPTY_MASK, Result.EMPTY_MASK.value)
    needed = settings.points.min_points
    counts = PointCounts(in_prompt=region.in_prompt, above_ground=region.found)
    kind = "box" if ids is None else "mask"
    if region.in_prompt < needed:
        sentence = Result.TOO_FEW_POINTS.value.format(region=kind, found=region.in_prompt, needed=needed)
        return ObjectLabel(index, prompt, Result.TOO_FEW_POINTS, sentence, points=counts)
    sentence = Result.NO_OBJECT_POINTS.value.format(region=kind, initial=region.in_prompt, needed=needed)
    return ObjectLabel(index, prompt, Result.NO_OBJECT_POINTS, sentence, points=counts)


def _told(view: View, decision: Decision, settings: LabellerSettings) -> ObjectLabel:
    """The label of a prompt that has hypotheses."""
    prompt = view.frame.prompts[decision.index]
    prior = settings.sizes[prompt.category]
    fixed = settings.repairs is not None and settings.repairs.size == "fixed"
    shown = decision.parameters.copy()
    if fixed:
        shown[:, LENGTH : HEIGHT + 1] = (prior.length_m, prior.width_m, prior.height_m)
    boxes = _facing_away(to_boxes(shown))
    chosen = decision.chosen
    counts = PointCounts(
        in_prompt=decision.region.in_prompt,
        above_ground=decision.region.found,
        in_cluster=round(float(np.expm1(decision.evidence.count[chosen]))),
        used=decision.used[chosen],
    )
    likely, strict = (probability(decision, iou) for iou in (0.5, 0.7))
    if likely < _NO_OBJECT:
        sentence = Result.NO_OBJECT.value.format(category=prompt.category, reason=_weakest(decision, chosen))
        return ObjectLabel(decision.index, prompt, Result.NO_OBJECT, sentence, points=counts)
    return ObjectLabel(
        index=decision.index,
        prompt=prompt,
        result=Result.FITTED,
        sentence=Result.FITTED.value,
        box=boxes[chosen : chosen + 1],
        score=likely * share_of(prompt.score),
        iou_probability=(likely, min(likely, strict)),
        flags=_flags(view, decision, counts, fixed=fixed),
        losses=decision.losses[chosen],
        points=counts,
        rejected=tuple(
            Hypothesis(boxes[row : row + 1], decision.losses[row], _why_not(decision, row))
            for row in np.argsort(decision.energy, kind="stable").tolist()
            if row != chosen
        ),
    )


def _facing_away(boxes: Boxes3D) -> Boxes3D:
    """Front and back look alike to the losses: of the two headings, the one away from the camera."""
    headings = [facing_away(float(yaw)) for yaw in boxes.rotation_y]
    return Boxes3D(boxes.center_cam, boxes.length_m, boxes.width_m, boxes.height_m, np.array(headings))


def _why_not(decision: Decision, row: int) -> str:
    """Why a hypothesis was not chosen: the term that speaks most against it."""
    worse = decision.energy[row] - decision.energy[decision.chosen]
    if worse < 0:
        return "Likelier by itself, but it stands where another object does."
    return f"Less likely by {worse:.1f}; most of it: {_weakest(decision, row, decision.chosen)}."


def _weakest(decision: Decision, row: int, than: int | None = None) -> str:
    """The term of the evidence that costs a hypothesis most, beside that of another where one is given."""
    cost = {name: weight * getattr(decision.evidence, name) for name, weight in EVIDENCE_WEIGHTS.items()}
    base = {name: 0.0 if than is None else value[than] for name, value in cost.items()}
    name = max(cost, key=lambda term: float(cost[term][row] - base[term]))
    values = getattr(decision.evidence, name)
    beside = "" if than is None else f" against {values[than]:.2f}"
    return f"{name} {values[row]:.2f}{beside}"


def _flags(view: View, decision: Decision, counts: PointCounts, *, fixed: bool) -> tuple[str, ...]:
    """Named reasons to look at a box twice, in a fixed order."""
    box = decision.parameters[decision.chosen]
    named = {
        "few_points": counts.in_cluster < _FEW_POINTS,
        # Nothing here tells front from back.
        "heading_ambiguous": True,
        "truncated": bool(decision.region.cut.any()),
        "size_from_prior": fixed or not _sides_seen(view, decision, box),
        "touching": bool(decision.evidence.spill[decision.chosen] > _TOUCHING_SPILL),
        "ground_uncertain": not view.ground.is_known(box[[X]], box[[Z]])[0],
    }
    return tuple(name for name, holds in named.items() if holds)


def _sides_seen(view: View, decision: Decision, box: Floats) -> bool:
    """Whether the points in the box reach along most of its length and of its width."""
    points_xz = view.points_cam[decision.region.inside][:, [0, 2]]
    along, across = (axis[0] for axis in to_box_frame(box[None], points_xz))
    inside = (np.abs(along) < box[LENGTH] / 2 + 0.2) & (np.abs(across) < box[WIDTH] / 2 + 0.2)
    if not inside.any():
        return False
    seen = np.ptp(along[inside]) / box[LENGTH], np.ptp(across[inside]) / box[WIDTH]
    return bool(min(seen) > _SEEN_SHARE)
