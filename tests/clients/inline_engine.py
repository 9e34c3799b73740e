"""An engine that labels in this process, one frame after the other: what a run does without its workers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import boxlift
from boxlift.formats.details import FrameDetails, details_of
from boxlift.frame import Frame, FrameLabels, Result
from boxlift_client.engines import LabellerIdentity
from boxlift_client.job import FrameReport, FrameWorker, LabelJob


def say_nothing(frame: Frame) -> FrameDetails:
    """Instead of a labeller: no prompt has a box."""
    return details_of(FrameLabels.without_boxes(frame.name, frame.prompts, Result.NO_LIDAR))


@dataclass
class InlineEngine:
    """`raises`: frame -> what comes up instead of its report (KeyboardInterrupt: Ctrl-C there)."""

    raises: Mapping[str, BaseException] = field(default_factory=dict)
    version: str = boxlift.__version__
    asked: list[str] = field(default_factory=list)

    def identity(self, job: LabelJob) -> LabellerIdentity:  # noqa: ARG002 - Engine's
        return LabellerIdentity(self.version, None)

    def run(self, job: LabelJob, names: Iterable[str]) -> Iterator[FrameReport]:
        def label(frame: Frame) -> FrameDetails:
            if isinstance(error := self.raises.get(frame.name), Exception):
                raise error
            return say_nothing(frame)

        worker = FrameWorker(job, label)
        for name in names:
            self.asked.append(name)
            if name in self.raises and not isinstance(self.raises[name], Exception):
                raise self.raises[name]
            yield worker.label_one(name)
