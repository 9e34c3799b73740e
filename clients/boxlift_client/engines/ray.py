"""A Ray cluster: actors label, each with its own labeller; the driver hands out frames and keeps the ledger.

Ray Data would batch frames and retry blocks by itself; here each frame has its own time limit, deaths and
row in the ledger, which the loop in dispatch.py already gives to processes, so that actors are one more crew.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from boxlift.errors import BoxliftError, MissingExtraError, OptionsError
from boxlift_client.engines import LabellerIdentity, own_identity
from boxlift_client.engines.dispatch import Died, Done, Ready, dispatch
from boxlift_client.engines.worker_process import MakeWorker, frame_worker
from boxlift_client.job import FrameReport, LabelJob

_CPUS_PER_WORKER = 1.0


class RayEngine:
    """`workers` actors, without a number as many as the cluster has CPUs for.

    address: of the cluster, `auto` or HOST:PORT; where None, RAY_ADDRESS, else one that is started here and
    ends with the run. gpus: what each actor claims; labelling uses none, but a cluster may be laid out so.
    make_worker: what labels in each of them.
    """

    def __init__(
        self,
        workers: int | None = None,
        *,
        address: str | None = None,
        gpus: float = 0.0,
        make_worker: MakeWorker = frame_worker,
    ) -> None:
        self._workers = workers
        self._address = address or os.environ.get("RAY_ADDRESS") or None
        self._gpus = gpus
        self._make_worker = make_worker

    def identity(self, job: LabelJob) -> LabellerIdentity:
        """See Engine.identity. Raises ModelFileError. The nodes must have the version that is here."""
        return own_identity(job)

    def run(self, job: LabelJob, names: Sequence[str]) -> Iterator[FrameReport]:
        """See Engine.run. Raises OptionsError where there is no such cluster, or it cannot see the files."""
        ray = _ray()
        ours = not ray.is_initialized()
        if ours:
            _connect(ray, self._address)
        try:
            _require_shared_storage(ray, job)
            workers = self._workers or _workers_of(ray, self._gpus)
            crew = _ActorCrew(ray, job, self._make_worker, self._gpus)
            yield from dispatch(crew, names, min(workers, len(names)), job.frame_timeout_s)
        finally:
            if ours:
                ray.shutdown()


class LabelActor:
    """What runs on the nodes: a worker that is made once."""

    def __init__(self, make_worker: MakeWorker, job: LabelJob) -> None:
        self._problem: BoxliftError | str | None = None
        try:
            self._worker = make_worker(job)
        except BoxliftError as error:
            self._problem = error
        except ImportError as error:
            self._problem = str(error)

    def problem(self) -> BoxliftError | str | None:
        """Why it cannot label, if it cannot."""
        return self._problem

    def label_one(self, name: str) -> FrameReport:
        """See FrameWorker.label_one."""
        return self._worker.label_one(name)


class _ActorCrew:
    """Crew of actors. Each has one call that is under way, or none."""

    def __init__(self, ray: Any, job: LabelJob, make_worker: MakeWorker, gpus: float) -> None:
        self._ray = ray
        self._job = ray.put(job)
        self._make_worker = make_worker
        # Restarts are for dispatch to decide: it knows the frame that an actor died of.
        self._actor_class = ray.remote(LabelActor).options(
            num_cpus=_CPUS_PER_WORKER,
            num_gpus=gpus,
            max_restarts=0,
            runtime_env={"env_vars": dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")},
        )
        self._calls: dict[Any, Any] = {}

    def start(self) -> Any:
        actor = self._actor_class.remote(self._make_worker, self._job)
        self._calls[actor.problem.remote()] = actor
        return actor

    def give(self, worker: Any, name: str) -> None:
        self._calls[worker.label_one.remote(name)] = worker

    def wait(self, timeout_s: float) -> list[Ready[Any] | Done[Any] | Died[Any]]:
        if not self._calls:
            return []
        finished, _ = self._ray.wait(list(self._calls), num_returns=1, timeout=timeout_s)
        events: list[Ready[Any] | Done[Any] | Died[Any]] = []
        for call in finished:
            actor = self._calls.pop(call)
            try:
                answer = self._ray.get(call)
            except self._ray.exceptions.RayError:
                events.append(Died(actor))
                continue
            events.append(Done(actor, answer) if isinstance(answer, FrameReport) else Ready(actor, answer))
        return events

    def end(self, worker: Any) -> None:
        self._calls = {call: actor for call, actor in self._calls.items() if actor != worker}
        self._ray.kill(worker, no_restart=True)


def _ray() -> Any:  # Ray's types stop at its decorators.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray
    except ImportError:
        raise MissingExtraError("ray", "ray") from None
    return ray


def _connect(ray: Any, address: str | None) -> None:
    own = {"include_dashboard": False} if address is None else {}
    try:
        ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR, **own)
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise OptionsError(
            "ray_address",
            f"there is no Ray cluster at {address!r} ({error}).",
            "Start one with `ray start --head`, or leave --ray-address out to have one for this run.",
        ) from None


def _require_shared_storage(ray: Any, job: LabelJob) -> None:
    """A folder of this machine is no place for what other nodes write, unless it is mounted there too."""
    nodes = sum(node["Alive"] for node in ray.nodes())
    if nodes > 1 and isinstance(job.out, Path) and not _is_mounted(job.out):
        raise OptionsError(
            "out",
            f"{str(job.out)!r} is on this machine's own disk, and the cluster has {nodes} nodes.",
            "Give a folder on storage that all nodes mount, or s3://BUCKET/FOLDER.",
        )


def _is_mounted(path: Path) -> bool:
    """Whether a path is on a file system of its own, as network storage is."""
    path = path.absolute()
    return any(each.is_mount() for each in (path, *path.parents[:-1]))


def _workers_of(ray: Any, gpus: float) -> int:
    resources = ray.cluster_resources()
    workers = int(resources.get("CPU", 1) / _CPUS_PER_WORKER)
    return max(1, min(workers, int(resources.get("GPU", 0) / gpus)) if gpus else workers)
