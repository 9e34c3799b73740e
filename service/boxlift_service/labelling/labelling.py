"""The way of a frame through the workers: its objects are found, if they did not come along, and labelled."""

from __future__ import annotations

from boxlift_service.bodies.shared_parts import SharedParts
from boxlift_service.detection.detection import Detection
from boxlift_service.detection.tasks import FindPromptsTask
from boxlift_service.labelling.tasks import AnswerFormat, LabelledFrame, LabelTask
from boxlift_service.telemetry.timing import RequestTimes
from boxlift_service.workers.deadline import Deadline
from boxlift_service.workers.pool import WorkerPool

# A permit is a million objects x points. Every frame costs something, and its points are known by their
# bytes: 16 a return in KITTI's .bin, about as many in all other formats.
_LEAST_WORK = 0.25
_BYTES_PER_POINT = 16
_OBJECTS_FOUND = 10


class Labelling:
    """Labels frames with the workers of `labellers`, and finds their prompts by `detection`."""

    def __init__(self, labellers: WorkerPool, detection: Detection) -> None:
        self.labellers = labellers
        self._detection = detection

    async def label(
        self,
        parts: SharedParts,
        answer: AnswerFormat,
        times: RequestTimes,
        *,
        wait: bool = False,
        deadline: Deadline | None = None,
    ) -> LabelledFrame:
        """The labels of the frame whose `parts` are those of POST /label.

        wait: for permits, instead of being refused. Raises InputError for wrong parts, and ProblemError: too
        much work (429), the worker was lost or a model failed (500), none is ready or installed (503), the
        deadline passed (504).
        """
        async with self.labellers.permitted(work_of(parts), wait=wait, deadline=deadline):
            found = None
            if "prompts" not in parts and "image" in parts:
                with times.stage("detect"):
                    find = FindPromptsTask(parts.index())
                    found, _ = await self._detection.run(find, parts, wait=wait, deadline=deadline)
            labelled: LabelledFrame
            labelled, waited_s = await self.labellers.run(
                LabelTask(parts.index(), answer, found), parts.descriptor(), deadline
            )
        times.seconds["queue"] = times.seconds.get("queue", 0.0) + waited_s
        times.seconds.update(labelled.seconds)
        return labelled


def work_of(parts: SharedParts) -> float:
    """Permits that a frame takes, as far as its size tells."""
    points = parts.size("points") / _BYTES_PER_POINT
    objects = _OBJECTS_FOUND
    if "prompts" in parts:
        objects = parts.read("prompts")[0].data.count(b'"box"')
    return max(_LEAST_WORK, objects * points / 1e6)
