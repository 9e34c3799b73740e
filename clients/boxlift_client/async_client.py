"""A boxlift service, asked by a program on an event loop (asyncio).

>>> async with AsyncClient("http://127.0.0.1:8000") as client:  # doctest: +SKIP
...     async for outcome in client.label_batch(frames):
...         print(outcome.name, outcome.error or outcome.answer.kitti_text)

Files, images and answers are read in a thread, so that the loop goes on meanwhile.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterable, AsyncIterator, Callable, Coroutine, Iterable, Mapping, Sequence
from itertools import islice
from types import TracebackType
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Calibration
from boxlift.frame import Frame, Prompt
from boxlift.settings import ACCURATE, LabellerSettings
from boxlift_client.batch import FrameGroups, FrameOutcome, Item
from boxlift_client.calls import Calls, Encoding
from boxlift_client.client import BATCHES_IN_FLIGHT, DEFAULT_PATIENCE_S, DEFAULT_TIMEOUT_S, DEFAULT_URL
from boxlift_client.detect_answer import DetectAnswer
from boxlift_client.http_exchange import Done, Pause, Steps, httpx, next_step
from boxlift_client.label_answer import LabelAnswer
from boxlift_client.label_request import FrameFiles
from boxlift_client.request_parts import File

T = TypeVar("T")
Given = TypeVar("Given")
Result = TypeVar("Result")


class AsyncClient:
    """Client with calls to await; see there. Use it as an async context manager, or close it."""

    def __init__(
        self,
        base_url: str = DEFAULT_URL,
        *,
        timeout_s: float = DEFAULT_TIMEOUT_S,
        api_key: str | None = None,
        patience_s: float = DEFAULT_PATIENCE_S,
        encoding: Encoding = "msgpack",
    ) -> None:
        self._calls = Calls(base_url, timeout_s, api_key, patience_s, encoding)
        self._http = self._calls.http(httpx.AsyncClient)

    @property
    def base_url(self) -> str:
        """Where the service is."""
        return self._calls.url

    async def label(
        self, frame: Frame, settings: LabellerSettings = ACCURATE, *, detect: bool = False
    ) -> LabelAnswer:
        """See Client.label."""
        return await self._take(self._calls.label(frame, settings, detect))

    async def label_files(
        self,
        points: File,
        calib: File,
        prompts: Sequence[Prompt] | None = None,
        *,
        image: File | None = None,
        masks: File | None = None,
        name: str | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> LabelAnswer:
        """See Client.label_files."""
        files = FrameFiles(points, calib, prompts, image, masks, name, options)
        return await self._take(self._calls.label_files(files))

    async def label_batch(
        self,
        frames: Iterable[Frame | FrameFiles] | AsyncIterable[Frame | FrameFiles],
        settings: LabellerSettings = ACCURATE,
        *,
        detect: bool = False,
    ) -> AsyncIterator[FrameOutcome]:
        """See Client.label_batch."""
        groups = self._groups(frames, settings, detect)
        async for outcomes in _in_tasks(
            lambda group: self._take(self._calls.label_batch(group)), groups, BATCHES_IN_FLIGHT
        ):
            for outcome in outcomes:
                yield outcome

    async def detect(
        self,
        image: NDArray[np.uint8],
        calibration: Calibration,
        prompts: Sequence[Prompt] | None = None,
        *,
        min_score: float | None = None,
        name: str = "frame",
    ) -> DetectAnswer:
        """See Client.detect."""
        return await self._take(self._calls.detect(image, calibration, prompts, min_score, name))

    async def detect_files(
        self,
        images: Sequence[File],
        calibs: Sequence[File],
        prompts: Sequence[Sequence[Prompt]] | None = None,
        *,
        min_score: float | None = None,
        names: Sequence[str] | None = None,
    ) -> DetectAnswer:
        """See Client.detect_files."""
        return await self._take(self._calls.detect_files(images, calibs, prompts, min_score, names))

    async def health(self) -> bool:
        """See Client.health."""
        return await self._take(self._calls.answers_ok("/healthz"))

    async def ready(self) -> bool:
        """See Client.ready."""
        return await self._take(self._calls.answers_ok("/readyz"))

    async def wait_until_ready(self, timeout_s: float = 60.0) -> None:
        """See Client.wait_until_ready."""
        await self._take(self._calls.wait_until_ready(timeout_s))

    async def models(self) -> dict[str, Any]:
        """See Client.models."""
        return await self._take(self._calls.models())

    async def close(self) -> None:
        """Close all connections."""
        await self._http.aclose()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        error_type: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        await self.close()

    async def _groups(
        self,
        frames: Iterable[Frame | FrameFiles] | AsyncIterable[Frame | FrameFiles],
        settings: LabellerSettings,
        detect: bool,
    ) -> AsyncIterator[list[Item]]:
        groups = FrameGroups()
        index = 0
        async for frame in _each(frames):
            item = await asyncio.to_thread(self._calls.pack, index, frame, settings, detect)
            index += 1
            for group in groups.add(item):
                yield group
        for group in groups.rest():
            yield group

    async def _take(self, steps: Steps[T]) -> T:
        answer: httpx.Response | None = None
        error: httpx.HTTPError | httpx.InvalidURL | None = None
        while not isinstance(step := await asyncio.to_thread(next_step, steps, answer, error), Done):
            answer = error = None
            if isinstance(step, Pause):
                await asyncio.sleep(step.seconds)
                continue
            try:
                answer = await self._http.request(**step.arguments)
            except (httpx.HTTPError, httpx.InvalidURL) as raised:
                error = raised
        return step.value


async def _each(items: Iterable[T] | AsyncIterable[T]) -> AsyncIterator[T]:
    """The items; those of an ordinary iterable are taken in a thread, for it may read files."""
    if isinstance(items, AsyncIterable):
        async for item in items:
            yield item
        return
    iterator = iter(items)
    while found := await asyncio.to_thread(lambda: list(islice(iterator, 1))):
        yield found[0]


async def _in_tasks(
    work: Callable[[Given], Coroutine[Any, Any, Result]], items: AsyncIterator[Given], workers: int
) -> AsyncIterator[Result]:
    """What `work` says of every item, as it finishes, that many at a time; items are taken as needed."""
    in_flight: set[asyncio.Task[Result]] = set()
    exhausted = False
    try:
        while True:
            while not exhausted and len(in_flight) < workers:
                try:
                    in_flight.add(asyncio.create_task(work(await anext(items))))
                except StopAsyncIteration:
                    exhausted = True
            if not in_flight:
                return
            done, in_flight = await asyncio.wait(in_flight, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                yield task.result()
    finally:
        for task in in_flight:
            task.cancel()
        await asyncio.gather(*in_flight, return_exceptions=True)
