"""Workers that do not label (a stand-in for FrameWorker, told as such): a frame's name says its fate."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from boxlift_client.job import FrameReport, LabelJob, Outcome


class OddWorker:
    """`dies` kills the process, `dies once` so the first time, `hangs` hangs, `tells` tells a variable.

    Others are labelled.
    """

    def __init__(self, job: LabelJob) -> None:
        self._marks = Path(str(job.out))

    def label_one(self, name: str) -> FrameReport:
        """See FrameWorker.label_one."""
        mark = self._marks / name
        if name == "dies" or (name == "dies once" and not mark.exists()):
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        if name == "hangs":
            time.sleep(600)
        if name == "tells":
            return FrameReport(name, Outcome.LABELLED, os.environ.get("BOXLIFT_TOLD", ""))
        return FrameReport(name, Outcome.LABELLED, seconds=0.001)


def raising_worker(job: LabelJob) -> OddWorker:
    """One that cannot be made."""
    raise ValueError(f"nothing is at {job.source.name}")
