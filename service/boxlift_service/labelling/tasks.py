"""What a label worker is asked to do: plain data on its way there, work once it is there."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass, field, replace
from enum import StrEnum

from boxlift.formats import xtreme1
from boxlift.formats.details import details_of, kitti_text
from boxlift.frame import FrameLabels
from boxlift.stage_times import StageTimes
from boxlift_service.answers import label_answer_of
from boxlift_service.bodies.shared_parts import PartsIndex
from boxlift_service.detection.tasks import FoundPrompts
from boxlift_service.labelling.decoding import LabelRequest, decode_label_request
from boxlift_service.labelling.worker import LabelWorker


class AnswerFormat(StrEnum):
    """How the labels of a frame are told."""

    JSON = "application/json"
    TEXT = "text/plain"
    XTREME1 = "xtreme1"


@dataclass(frozen=True)
class LabelledFrame:
    """The body of an answer, how many objects had which result, and the seconds per stage."""

    content: bytes
    results: Counter[str]
    seconds: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class LabelTask:
    """Label the frame whose parts are there; where it came without prompts, with those that were found."""

    parts: PartsIndex
    answer: AnswerFormat
    found: FoundPrompts | None

    def __call__(self, worker: LabelWorker, file: int) -> LabelledFrame:
        """Raises InputError that names the field at fault."""
        # Here, for the server makes tasks too, and torch has no place there.
        from boxlift.labeller import Labeller

        times = StageTimes()
        with times.stage("decode"):
            parts = {name: parts[0] for name, parts in self.parts.read(file).items()}
            request = decode_label_request(parts, worker.limits, worker.presets)
            frame = request.frame
            if self.found is not None:
                frame = replace(
                    frame, prompts=self.found.prompts, instance_ids=self.found.read_instance_ids(file)
                )
        labels = Labeller(request.settings).label(frame, times)
        with times.stage("encode"):
            content = self._encoded(labels, request)
        results = Counter(label.result.name for label in labels.objects)
        return LabelledFrame(content, results, times.seconds)

    def _encoded(self, labels: FrameLabels, request: LabelRequest) -> bytes:
        if self.answer is AnswerFormat.TEXT:
            return kitti_text(details_of(labels)).encode()
        if self.answer is AnswerFormat.XTREME1:
            return json.dumps(xtreme1.results_of(labels, request.frame.calibration), allow_nan=False).encode()
        digest = None if self.found is None else self.found.model_digest
        answer = label_answer_of(labels, request.settings, request.dropped_points, digest)
        return answer.model_dump_json(by_alias=True).encode()
