"""A worker process of the local engine: frames in through a pipe, reports out.

This module is light, for the parent imports it too; what a worker needs is imported by preloaded.py.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Mapping
from multiprocessing.connection import Connection
from typing import Protocol

from boxlift.errors import BoxliftError
from boxlift.formats.details import FrameDetails
from boxlift.frame import Frame
from boxlift_client.job import FrameReport, FrameWorker, LabelJob


class LabelsOne(Protocol):
    """What a worker labels with: a FrameWorker."""

    def label_one(self, name: str) -> FrameReport:
        """See FrameWorker.label_one."""


# Importable by name, for it is called in the worker.
MakeWorker = Callable[[LabelJob], LabelsOne]


def work(
    make_worker: MakeWorker,
    job: LabelJob,
    pipe: Connection,
    lifeline: Connection,
    environment: Mapping[str, str],
) -> None:
    """In a new process: say whether it is ready, then label whatever comes, until the pipe closes.

    environment: of the runner now; the server that this process was forked from has that of its own start.
    """
    os.environ.update(environment)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()
    try:
        worker = make_worker(job)
    except BoxliftError as error:
        pipe.send(error)
        return
    except ImportError as error:
        pipe.send(str(error))
        return
    except Exception as error:  # of a storage library, say: told, rather than a process that dies
        pipe.send(f"{type(error).__name__}: {error}")
        return
    pipe.send(None)
    while True:
        try:
            name = pipe.recv()
        except EOFError:
            return
        pipe.send(worker.label_one(name))


def frame_worker(job: LabelJob) -> FrameWorker:
    """A labeller, and where it is needed a detector, of its own. Raises BoxliftError or ImportError."""
    from boxlift.extras import open3d

    open3d()
    return FrameWorker(job, _labeller(job))


def _labeller(job: LabelJob) -> Callable[[Frame], FrameDetails]:
    """Frame -> details, with the prompts that it has or, in a job that detects, with those that it finds."""
    import torch

    from boxlift.formats.details import details_of
    from boxlift.labeller import Labeller

    # Frames are many and their arrays small: processes scale, threads within one wait for each other.
    torch.set_num_threads(1)
    labeller = Labeller(job.settings)
    if not job.detects:
        return lambda frame: details_of(labeller.label(frame))
    from boxlift.detector import Detector, find_prompts

    detector = Detector.open(job.detector, threads=1)

    def label(frame: Frame) -> FrameDetails:
        prompted = find_prompts(frame, detector, job.settings.detection)
        return details_of(labeller.label(prompted), detector.digest)

    return label


def _end_with(lifeline: Connection) -> None:
    """End this process when the parent lets go of its end, also by being killed."""
    lifeline.poll(None)
    os._exit(1)
