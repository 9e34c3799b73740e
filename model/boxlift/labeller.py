"""The pipeline, readable aloud."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np

from boxlift.boxes import Boxes3D
from boxlift.confidence import flags_of, score_of
from boxlift.consistency import agree_with_prompts, cut_edges
from boxlift.fit import FitProblem, FitSolution, fit_boxes
from boxlift.frame import Frame, FrameLabels, Hypothesis, ObjectLabel, Result
from boxlift.ground import find_ground
from boxlift.heading import HeadingHypothesis, heading_hypotheses
from boxlift.object_points import ObjectPoints, UnusablePrompt, points_in_image, select_object_points
from boxlift.rig_check import check_rig
from boxlift.settings import PAPER, LabellerSettings


@dataclass
class StageTimes:
    """Seconds per stage of one `label` call, in the order the stages ran."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the body of a `with` under `name`."""
        start = perf_counter()
        yield
        self.seconds[name] = perf_counter() - start


@dataclass(frozen=True)
class _Candidate:
    """One object with one hypothesis of its heading."""

    points: ObjectPoints
    heading: HeadingHypothesis


class Labeller:
    """2D boxes and LiDAR in, 3D boxes out, by the losses of WeakM3D and without any training."""

    def __init__(self, settings: LabellerSettings = PAPER) -> None:
        self.settings = settings

    def label(self, frame: Frame, times: StageTimes | None = None) -> FrameLabels:
        """Label every prompt of a frame: a box, or the sentence why there is none."""
        times = times or StageTimes()
        with times.stage("rig"):
            warnings = check_rig(frame, self.settings.sizes)
        with times.stage("ground"):
            visible = points_in_image(frame)
            ground = find_ground(visible.cam, frame.name, self.settings.ground)
        with times.stage("points"):
            found = select_object_points(frame, visible, ground, self.settings.points, self.settings.sizes)
        with times.stage("heading"):
            candidates = self._candidates(found)
        with times.stage("fit"):
            problems = self._problems(frame, candidates)
            fits = fit_boxes(
                problems, self.settings.fit, self.settings.loss, self.settings.points.sample_count
            )
        with times.stage("consistency"):
            boxes = self._place(frame, candidates, fits)
        with times.stage("confidence"):
            uncertain = self.settings.ground.remove and not ground.found
            described = self._describe(frame, found, candidates, fits, boxes, uncertain)
        return FrameLabels(frame.name, described, warnings)

    def fit_problems(self, frame: Frame) -> list[FitProblem]:
        """What `label` hands to the fit: one problem per object and hypothesis. For benchmarks."""
        visible = points_in_image(frame)
        ground = find_ground(visible.cam, frame.name, self.settings.ground)
        found = select_object_points(frame, visible, ground, self.settings.points, self.settings.sizes)
        return self._problems(frame, self._candidates(found))

    def _candidates(self, found: Sequence[ObjectPoints | UnusablePrompt]) -> list[_Candidate]:
        """Every object with every hypothesis of its heading, the chosen one first."""
        return [
            _Candidate(item, heading)
            for item in found
            if isinstance(item, ObjectPoints)
            for heading in heading_hypotheses(item.used, item.cluster, self.settings.heading)
        ]

    def _problems(self, frame: Frame, candidates: Sequence[_Candidate]) -> list[FitProblem]:
        """What is left to find for each candidate: its centre (x, z), size and heading frozen."""
        from_lidar = self.settings.loss.ray_origin == "lidar"
        calibration = frame.calibration
        origin_cam = calibration.lidar_center_cam if from_lidar else calibration.camera_center_cam
        sizes = self.settings.sizes
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

    def _place(self, frame: Frame, candidates: Sequence[_Candidate], fits: Sequence[FitSolution]) -> Boxes3D:
        """Boxes of all candidates, set on y by their points and then by their prompts."""
        if not candidates:
            return Boxes3D.empty()
        settings = self.settings.consistency
        prompts = [frame.prompts[item.points.prompt_index] for item in candidates]
        priors = [self.settings.sizes[prompt.category] for prompt in prompts]
        # SmoothL1 to the mean y of the points (equation 6) has its minimum at that mean.
        y = [getattr(item.points, settings.y_from)[:, 1].mean() for item in candidates]
        x, z = np.stack([fit.center_xz for fit in fits]).T
        boxes = Boxes3D(
            center_cam=np.stack([x, y, z], axis=1),
            length_m=np.array([prior.length_m for prior in priors]),
            width_m=np.array([prior.width_m for prior in priors]),
            height_m=np.array([prior.height_m for prior in priors]),
            rotation_y=np.array([item.heading.rotation_y for item in candidates]),
        )
        prompts_px = np.array([prompt.box_px for prompt in prompts])
        return agree_with_prompts(boxes, prompts_px, frame.calibration, frame.image_size_px, settings)

    def _describe(
        self,
        frame: Frame,
        found: Sequence[ObjectPoints | UnusablePrompt],
        candidates: Sequence[_Candidate],
        fits: Sequence[FitSolution],
        boxes: Boxes3D,
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
