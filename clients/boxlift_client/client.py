"""A boxlift service, asked by a program that waits for each answer.

>>> with Client("http://127.0.0.1:8000") as client:  # doctest: +SKIP
...     answer = client.label_files(Path("000010.bin"), Path("000010.txt"), prompts, image=Path("000010.png"))
...     print(answer.kitti_text)

What is asked is in calls; here it only travels. AsyncClient is the same for programs on an event loop.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import TracebackType
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Calibration
from boxlift.frame import Frame, Prompt
from boxlift.settings import ACCURATE, LabellerSettings
from boxlift_client.batch import FrameGroups, FrameOutcome, Item
from boxlift_client.calls import Calls, Encoding
from boxlift_client.detect_answer import DetectAnswer
from boxlift_client.http_exchange import Done, Pause, Steps, httpx, next_step
from boxlift_client.in_threads import in_threads
from boxlift_client.label_answer import LabelAnswer
from boxlift_client.label_request import FrameFiles
from boxlift_client.request_parts import File

T = TypeVar("T")

DEFAULT_URL = "http://127.0.0.1:8000"
DEFAULT_TIMEOUT_S = 120.0
DEFAULT_PATIENCE_S = 60.0

# While one is answered, the next is on its way.
BATCHES_IN_FLIGHT = 2


class Client:
    """Talks to the service at `base_url`; threads may share one. Use it as a context manager, or close it.

    timeout_s: for an answer; the service is told, and computes no longer than that. api_key: where the
    service asks for one; the variable BOXLIFT_API_KEY where None. patience_s: how long in all a request is
    made again while the service says that it is busy. encoding: of POST /label.

    Raises OptionsError where the key is no key, ServiceUnreachableError where the URL is no URL.
    """

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
        self._http = self._calls.http(httpx.Client)

    @property
    def base_url(self) -> str:
        """Where the service is."""
        return self._calls.url

    def label(
        self, frame: Frame, settings: LabellerSettings = ACCURATE, *, detect: bool = False
    ) -> LabelAnswer:
        """Label a frame's prompts with exactly these settings: the labels of Labeller(settings), rounded.

        detect: the service finds the prompts, in the frame's image, instead of those that it has. Raises
        ServiceError (RequestRefusedError where the frame is at fault, and see its tree), ImageError where
        there is no image to detect in.
        """
        return self._take(self._calls.label(frame, settings, detect))

    def label_files(
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
        """Label files, or their bytes, in any format that the service reads; see FrameFiles.

        Raises ServiceError as `label` does, InputError where a file cannot be read.
        """
        files = FrameFiles(points, calib, prompts, image, masks, name, options)
        return self._take(self._calls.label_files(files))

    def label_batch(
        self,
        frames: Iterable[Frame | FrameFiles],
        settings: LabellerSettings = ACCURATE,
        *,
        detect: bool = False,
    ) -> Iterator[FrameOutcome]:
        """Label many frames, some in each request; what becomes of each, as it is known.

        settings, detect: as `label` has them, of each Frame; FrameFiles have their own options. The frames
        are taken from `frames` as they are needed. What is wrong with a frame is its outcome's error; raises
        ServiceError where it is not one frame's.
        """
        groups = self._groups(frames, settings, detect)
        for outcomes in in_threads(
            lambda group: self._take(self._calls.label_batch(group)), groups, BATCHES_IN_FLIGHT
        ):
            yield from outcomes

    def detect(
        self,
        image: NDArray[np.uint8],
        calibration: Calibration,
        prompts: Sequence[Prompt] | None = None,
        *,
        min_score: float | None = None,
        name: str = "frame",
    ) -> DetectAnswer:
        """Find the objects of one image, (H, W, 3) uint8 RGB, and their 3D boxes; or lift its `prompts`.

        Of `calibration` only the camera is sent. What is found with a score below `min_score` is left out.
        Raises ServiceError as `label` does, ImageError where the array is no image.
        """
        return self._take(self._calls.detect(image, calibration, prompts, min_score, name))

    def detect_files(
        self,
        images: Sequence[File],
        calibs: Sequence[File],
        prompts: Sequence[Sequence[Prompt]] | None = None,
        *,
        min_score: float | None = None,
        names: Sequence[str] | None = None,
    ) -> DetectAnswer:
        """As `detect`, for files, or their bytes, in any format that the service reads.

        calibs: one for all images or one for each. prompts: one sequence per image. names: of the images
        in the answer; the stems of their files where None. Raises ServiceError as `label` does,
        InputError where a file cannot be read.
        """
        return self._take(self._calls.detect_files(images, calibs, prompts, min_score, names))

    def health(self) -> bool:
        """Whether a service answers at all. Raises nothing where nobody does."""
        return self._take(self._calls.answers_ok("/healthz"))

    def ready(self) -> bool:
        """Whether the service can label now. Raises nothing where nobody answers."""
        return self._take(self._calls.answers_ok("/readyz"))

    def wait_until_ready(self, timeout_s: float = 60.0) -> None:
        """Return once the service can label; it may be warming up.

        Raises ServiceUnreachableError at once where nobody answers, ServiceFailedError where it is not
        ready in time, NotAuthorizedError where it does not know the API key.
        """
        self._take(self._calls.wait_until_ready(timeout_s))

    def models(self) -> dict[str, Any]:
        """What the service labels and detects with: the answer of GET /models."""
        return self._take(self._calls.models())

    def close(self) -> None:
        """Close all connections."""
        self._http.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        error_type: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def _groups(
        self, frames: Iterable[Frame | FrameFiles], settings: LabellerSettings, detect: bool
    ) -> Iterator[list[Item]]:
        groups = FrameGroups()
        for index, frame in enumerate(frames):
            yield from groups.add(self._calls.pack(index, frame, settings, detect))
        yield from groups.rest()

    def _take(self, steps: Steps[T]) -> T:
        answer: httpx.Response | None = None
        error: httpx.HTTPError | httpx.InvalidURL | None = None
        while not isinstance(step := next_step(steps, answer, error), Done):
            answer = error = None
            if isinstance(step, Pause):
                time.sleep(step.seconds)
                continue
            try:
                answer = self._http.request(**step.arguments)
            except (httpx.HTTPError, httpx.InvalidURL) as raised:
                error = raised
        return step.value
