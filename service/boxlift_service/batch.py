"""The frames of POST /label:batch: read no faster than they are labelled, answered as they are done."""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from starlette.requests import Request

from boxlift.errors import InputError
from boxlift_service.bodies.form import Field
from boxlift_service.bodies.msgpack_frames import MapReader
from boxlift_service.bodies.shared_parts import HeldBytes, SharedParts
from boxlift_service.labelling.decoding import label_fields
from boxlift_service.labelling.labelling import Labelling
from boxlift_service.labelling.tasks import AnswerFormat
from boxlift_service.lifecycle import Lifecycle
from boxlift_service.problems import Kind, ProblemError, problem_of
from boxlift_service.settings import ServiceSettings
from boxlift_service.telemetry.metrics import Metrics
from boxlift_service.telemetry.timing import RequestTimes
from boxlift_service.workers.deadline import Deadline

PATH = "/label:batch"

# Their names are remembered, so there is an end to them.
MOST_FRAMES = 10_000
# Of answers that the client has not taken yet; beyond it the service waits for it and reads no further.
_MOST_UNREAD_BYTES = 64 * 2**20
# How long a frame waits for room among the bodies that are held.
_WAITS_FOR_ROOM_S = 10.0

_log = logging.getLogger("boxlift_service")


@dataclass(frozen=True)
class BatchService:
    """What batches are labelled with."""

    labelling: Labelling
    settings: ServiceSettings
    held: HeldBytes
    metrics: Metrics
    lifecycle: Lifecycle

    @property
    def fields(self) -> Mapping[str, Field]:
        """Those of POST /label; the name is required, for answers come in another order."""
        fields = label_fields(self.settings)
        return {**fields, "name": replace(fields["name"], required=True)}

    @property
    def frames_ahead(self) -> int:
        """How many frames of a batch are held at a time: for each worker one in work and one at hand."""
        return 2 * self.settings.label_workers


class Batch:
    """The frames of one request, and the lines that answer them in order of completion."""

    def __init__(self, request: Request, service: BatchService) -> None:
        self._request = request
        self._service = service
        self._ahead = asyncio.Semaphore(service.frames_ahead)
        self._answers = _Answers()
        self._labelling: set[asyncio.Task[None]] = set()
        self._names: set[str] = set()
        self._frames = self._labelled = 0
        self._reads_no_more = asyncio.Event()

    async def lines(self) -> AsyncIterator[bytes]:
        """The lines of the answer, those together that are there together."""
        while lines := await self._answers.take():
            yield lines

    async def work(self) -> None:
        """Read and label all frames. Raises ClientDisconnect where the client goes before it sent them."""
        complete = await self._read_frames()
        self._reads_no_more.set()
        await asyncio.gather(*self._labelling)
        counts = {"frames": self._frames, "labelled": self._labelled, "failed": self._frames - self._labelled}
        self._put({**counts, "complete": complete})
        self._answers.end()

    async def client_gone(self) -> None:
        """Return when it is; what is left of a body that cannot be read is dropped meanwhile."""
        await self._reads_no_more.wait()
        try:
            while (await self._request.receive())["type"] != "http.disconnect":
                pass
        except ProblemError:  # it sends no more, and may still wait for the answer
            await asyncio.Event().wait()

    async def drop(self) -> None:
        """Drop what is not done: nobody waits for it, or everything is done."""
        for task in self._labelling:
            task.cancel()
        await asyncio.gather(*self._labelling, return_exceptions=True)

    async def _read_frames(self) -> bool:
        """Whether the stream was read to its end."""
        service, limits = self._service, self._service.settings
        reader = MapReader(
            self._request.stream(),
            service.fields,
            service.held,
            max_bytes=limits.max_body_bytes,
            waits_for_room_s=_WAITS_FOR_ROOM_S,
        )
        try:
            while not await reader.at_end():
                await self._ahead.acquire()
                await self._answers.room()
                self._refuse_more()
                parts = SharedParts(service.held)
                try:
                    async with asyncio.timeout(limits.receive_limit_s):
                        problem = await reader.read_map(parts)
                except TimeoutError:
                    parts.close()
                    raise self._too_slow() from None
                except BaseException:
                    parts.close()
                    raise
                self._begin(parts, problem)
        except ProblemError as error:
            self._fail(self._frames, None, error)
            self._frames += 1
            return False
        return True

    def _refuse_more(self) -> None:
        """Raises ProblemError where the next frame is not taken any more."""
        if self._service.lifecycle.ending:
            raise ProblemError(Kind.NOT_READY, "The service ends.", "Send this frame and the rest again.")
        if self._frames >= MOST_FRAMES:
            raise ProblemError(
                Kind.TOO_LARGE,
                f"The batch has more than {MOST_FRAMES} frames.",
                "Send the rest in another one.",
            )

    def _too_slow(self) -> ProblemError:
        return ProblemError(
            Kind.TIMEOUT,
            f"Frame {self._frames} was not complete after {self._service.settings.receive_limit_s:g} s.",
            "Send each frame in one go.",
        )

    def _begin(self, parts: SharedParts, problem: ProblemError | None) -> None:
        task = asyncio.create_task(self._answer(self._frames, parts, problem))
        self._frames += 1
        self._labelling.add(task)

        def end(_: object) -> None:
            parts.close()
            self._ahead.release()
            self._labelling.discard(task)

        task.add_done_callback(end)

    async def _answer(self, index: int, parts: SharedParts, problem: ProblemError | None) -> None:
        """Label the frame and put its line among the answers; whatever is wrong with it is its line."""
        name = None
        try:
            if "name" in parts:
                name = parts.read("name")[0].data.decode("utf-8", "replace")
            await self._label(index, name, parts, problem)
        except ProblemError as error:
            self._fail(index, name, error)
        except InputError as error:
            self._fail(index, name, problem_of(error))
        # The last net, as for a request: no fault of one frame may cost the others.
        except Exception:
            _log.exception("frame %d of a batch failed", index)
            request_id = self._request.state.request_id
            self._fail(
                index,
                name,
                ProblemError(
                    Kind.INTERNAL_ERROR,
                    f"Frame {index} of request {request_id} failed for a reason that is ours.",
                    "The service's log holds the cause under this id.",
                ),
            )

    async def _label(
        self, index: int, name: str | None, parts: SharedParts, problem: ProblemError | None
    ) -> None:
        if problem is not None:
            raise problem
        assert name is not None, "it is a required field"
        if name in self._names:
            raise ProblemError(
                Kind.INVALID_FIELD,
                f"An earlier frame of this batch is named {name!r:.60}.",
                "Give every frame a name of its own.",
                field="name",
            )
        self._names.add(name)
        service, times = self._service, RequestTimes()
        labelled = await service.labelling.label(
            parts, AnswerFormat.JSON, times, wait=True, deadline=Deadline.of(self._request)
        )
        service.metrics.count_results(PATH, labelled.results)
        service.metrics.observe_stages(PATH, times.seconds)
        self._labelled += 1
        head = json.dumps({"frame": name, "index": index, "status": 200})
        self._answers.put(head[:-1].encode() + b', "answer": ' + labelled.content + b"}\n")

    def _fail(self, index: int, name: str | None, error: ProblemError) -> None:
        details = error.details(self._request.url.path).model_dump(exclude_none=True)
        self._put({"frame": name, "index": index, "status": error.kind.status, "problem": details})

    def _put(self, line: Mapping[str, Any]) -> None:
        self._answers.put(json.dumps(line, allow_nan=False).encode() + b"\n")


class _Answers:
    """Lines that the client has not taken yet."""

    def __init__(self) -> None:
        self._lines: list[bytes] = []
        self._bytes = 0
        self._ended = False
        self._news = asyncio.Event()
        self._has_room = asyncio.Event()
        self._has_room.set()

    def put(self, line: bytes) -> None:
        self._lines.append(line)
        self._bytes += len(line)
        self._news.set()
        if self._bytes > _MOST_UNREAD_BYTES:
            self._has_room.clear()

    def end(self) -> None:
        """No line comes any more."""
        self._ended = True
        self._news.set()

    async def room(self) -> None:
        """Wait until there is room for further lines."""
        await self._has_room.wait()

    async def take(self) -> bytes:
        """The lines that are there, once there are any; none at the end."""
        await self._news.wait()
        lines = b"".join(self._lines)
        self._lines.clear()
        self._bytes = 0
        if not self._ended:
            self._news.clear()
        self._has_room.set()
        return lines
