"""The paper's way (and, by its settings, the release's): every step once, in the paper's order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from boxlift.boxes import Boxes3D
from boxlift.confidence import flags_of, score_of
from boxlift.consistency import agree_with_prompts, cut_edges
from boxlift.fit import FitProblem, FitSolution, fit_boxes
from boxlift.frame import Frame, Hypothesis, ObjectLabel, Result
from boxlift.ground import find_ground
from boxlift.heading import HeadingHypothesis, heading_hypotheses
from boxlift.object_points import ObjectPoints, UnusablePrompt, points_in_image, select_object_points
from boxlift.settings import LabellerSettings
from boxlift.stage_times import StageTimes


@dataclass(frozen=True)
class _Candidate:
    """One object with one hypothesis of its heading."""

    points: ObjectPoints
    heading: HeadingHypothesis


def label_faithfully(frame: Frame, settings: LabellerSettings, times: StageTimes) -> tuple[ObjectLabel, ...]:
    """Every prompt of a frame, in their order: a box, or the sentence why there is none."""
    with times.stage("ground"):
        visible = points_in_image(frame)
        ground = find_ground(visible.cam, frame.name, settings.ground)
    with times.stage("points"):
        found = select_object_points(frame, visible, ground, settings.points, settings.sizes)
    with times.stage("heading"):
        candidates = _candidates(found, settings)
    with times.stage("fit"):
        problems = _problems(frame, candidates, settings)
        fits = fit_boxes(problems, settings.fit, settings.loss, settings.points.sample_count)
    with times.stage("consistency"):
        boxes = _place(frame, candidates, fits, settings)
    with times.stage("confidence"):
        uncertain = settings.ground.remove and not ground.found
        return _describe(frame, found, candidates, fits, boxes, ground_uncertain=uncertain)


def fit_problems(frame: Frame, settings: LabellerSettings) -> list[FitProblem]:
    """What is handed to the fit: one problem per object and hypothesis. For benchmarks."""
    visible = points_in_image(frame)
    ground = find_ground(visible.cam, frame.name, settings.ground)
    found = select_object_points(frame, visible, ground, settings.points, settings.sizes)
    return _problems(frame, _candidates(found, settings), settings)


def _candidates(
    found: Sequence[ObjectPoints | UnusablePrompt], settings: LabellerSettings
) -> list[_Candidate]:
    """Every object with every hypothesis of its heading, the chosen one first."""
    return [
        _Candidate(item, heading)
        for item in found
        if isinstance(item, ObjectPoints)
        for heading in heading_hypotheses(item.used, item.cluster, settings.heading)
    ]


def _problems(frame: Frame, candidates: Sequence[_Candidate], settings: LabellerSettings) -> list[FitProblem]:
    """What is left to find for each candidate: its centre (x, z), size and heading frozen."""
    from_lidar = settings.loss.ray_origin == "lidar"
    calibration = frame.calibration
    origin_cam = calibration.lidar_center_cam if from_lidar else calibration.camera_center_cam
    sizes = settings.sizes
    priors = [sizes[frame.prompts[item.points.prompt_index].category] for item in candidates]
    return [
        FitProblem(
            points_xz=item.points.used[:, [0, 2]],
            length_m=prior.length_m,
            width_m=prior.width_m,
            rotation_y=item.heading.rotation_y,
            origin_xz=origin_cam[[0, 2]],
        )
        for item, prior in zip(candidates, priors, strict=True)
    ]


def _place(
    frame: Frame,
    candidates: Sequence[_Candidate],
    fits: Sequence[FitSolution],
    settings: LabellerSettings,
) -> Boxes3D:
    """Boxes of all candidates, set on y by their points and then by their prompts."""
    if not candidates:
        return Boxes3D.empty()
    consistency = settings.consistency
    prompts = [frame.prompts[item.points.prompt_index] for item in candidates]
    priors = [settings.sizes[prompt.category] for prompt in prompts]
    # SmoothL1 to the mean y of the points (equation 6) has its minimum at that mean.
    y = [getattr(item.points, consistency.y_from)[:, 1].mean() for item in candidates]
    x, z = np.stack([fit.center_xz for fit in fits]).T
    boxes = Boxes3D(
        center_cam=np.stack([x, y, z], axis=1),
        length_m=np.array([prior.length_m for prior in priors]),
        width_m=np.array([prior.width_m for prior in priors]),
        height_m=np.array([prior.height_m for prior in priors]),
        rotation_y=np.array([item.heading.rotation_y for item in candidates]),
    )
    prompts_px = np.array([prompt.box_px for prompt in prompts])
    return agree_with_prompts(boxes, prompts_px, frame.calibration, frame.image_size_px, consistency)


def _describe(
    frame: Frame,
    found: Sequence[ObjectPoints | UnusablePrompt],
    candidates: Sequence[_Candidate],
    fits: Sequence[FitSolution],
    boxes: Boxes3D,
    *,
    ground_uncertain: bool,
) -> tuple[ObjectLabel, ...]:
    """One label per prompt: the first hypothesis of an object is its box, the others were rejected."""
    labels = []
    for item in found:
        prompt = frame.prompts[item.prompt_index]
        if isinstance(item, UnusablePrompt):
            labels.append(
                ObjectLabel(item.prompt_index, prompt, item.result, item.sentence, points=item.counts)
            )
            continue
        rows = [row for row, candidate in enumerate(candidates) if candidate.points is item]
        chosen, *others = rows
        truncated = bool(cut_edges(np.array([prompt.box_px]), frame.image_size_px).any())
        labels.append(
            ObjectLabel(
                index=item.prompt_index,
                prompt=prompt,
                result=Result.FITTED,
                sentence=Result.FITTED.value,
                box=boxes[chosen : chosen + 1],
                score=score_of(fits[chosen].losses, item.counts, prompt.score),
                flags=flags_of(item.counts, truncated=truncated, ground_uncertain=ground_uncertain),
                losses=fits[chosen].losses,
                points=item.counts,
                rejected=tuple(
                    Hypothesis(boxes[row : row + 1], fits[row].losses, candidates[row].heading.reason)
                    for row in others
                ),
            )
        )
    return tuple(labels)
