"""A boxlift service, one frame at a time.

>>> with Client("http://127.0.0.1:8000") as client:  # doctest: +SKIP
...     answer = client.label_files(Path("000010.bin"), Path("000010.txt"), prompts, image=Path("000010.png"))
...     print(answer.kitti_text)

What is sent is built in label_request and detect_request, what comes back is read in label_answer and
detect_answer; here it only travels.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Calibration
from boxlift.errors import MissingExtraError
from boxlift.frame import Frame, Prompt
from boxlift.settings import ACCURATE, LabellerSettings
from boxlift_client.detect_answer import DetectAnswer
from boxlift_client.detect_request import File, Parts, parts_of_files, parts_of_image
from boxlift_client.errors import (
    ServiceError,
    ServiceFailedError,
    ServiceUnreachableError,
    UnexpectedAnswerError,
)
from boxlift_client.label_answer import LabelAnswer, problem_error, read_answer, read_label_answer
from boxlift_client.label_request import Form, form_of_files, form_of_frame

try:
    import httpx
except ModuleNotFoundError:
    raise MissingExtraError("httpx", "client") from None

DEFAULT_URL = "http://127.0.0.1:8000"

# Connections that the service closed while they lay idle break at their next use: asking again is safe,
# for the same frame gets the same labels.
_ATTEMPTS = 2
_BROKEN_CONNECTION = (httpx.RemoteProtocolError, httpx.ReadError, httpx.WriteError)


class Client:
    """Talks to the service at `base_url`; threads may share one. Use it as a context manager, or close it."""

    def __init__(self, base_url: str = DEFAULT_URL, *, timeout_s: float = 120.0) -> None:
        self.base_url = base_url.rstrip("/")
        try:
            self._http = httpx.Client(
                base_url=self.base_url, timeout=httpx.Timeout(timeout_s, connect=min(timeout_s, 10.0))
            )
        except httpx.InvalidURL as error:
            raise ServiceUnreachableError(base_url, f"this is no URL ({error}).") from None

    def label(
        self, frame: Frame, settings: LabellerSettings = ACCURATE, *, detect: bool = False
    ) -> LabelAnswer:
        """Label a frame's prompts with exactly these settings: the labels of Labeller(settings), rounded.

        detect: the service finds the prompts, in the frame's image, instead of those that it has. Raises
        ServiceError (RequestRefusedError where the frame is at fault, and see its tree), ImageError where
        there is no image to detect in.
        """
        answer = self._label(form_of_frame(frame, settings, detect=detect))
        if answer.settings_fingerprint != settings.fingerprint():
            raise UnexpectedAnswerError(
                self.base_url,
                f"the service labelled with the settings {answer.settings_fingerprint}, not with "
                f"{settings.fingerprint()} as asked: it is of another version ({answer.boxlift_version}).",
            )
        return answer

    def label_files(
        self,
        points: Path | str | bytes,
        calib: Path | str | bytes,
        prompts: Sequence[Prompt] | None = None,
        *,
        image: Path | str | bytes | None = None,
        masks: Path | str | bytes | None = None,
        name: str | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> LabelAnswer:
        """Label files, or their bytes, in any format that the service reads.

        points: .bin, .npy, .npz, .pcd or .ply. calib: KITTI text or JSON. prompts: without them the service
        finds the objects in the image. image: PNG or JPEG, needed for that and where `calib` does not say
        image_size. masks: 16-bit PNG, prompt index + 1. name: of the frame,
        which seeds random choices; the stem of a points file where None. options: a preset and what
        to change of it, e.g. {"preset": "release", "fit": {"method": "adam"}}.

        Raises ServiceError as `label` does, InputError where a file cannot be read.
        """
        form = form_of_files(points, calib, prompts, image=image, masks=masks, name=name, options=options)
        return self._label(form)

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
        return self._detect(parts_of_image(image, calibration, prompts, min_score, name))

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
        return self._detect(parts_of_files(images, calibs, prompts, min_score, names))

    def health(self) -> bool:
        """Whether a service answers at all. Raises nothing where nobody does."""
        return self._answers_ok("/healthz")

    def ready(self) -> bool:
        """Whether the service can label now. Raises nothing where nobody answers."""
        return self._answers_ok("/readyz")

    def wait_until_ready(self, timeout_s: float = 60.0) -> None:
        """Return once the service can label; it may be warming up.

        Raises ServiceUnreachableError at once where nobody answers, ServiceFailedError where it is not
        ready in time.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            try:
                self._send("GET", "/readyz")
                return
            except ServiceFailedError:
                if time.monotonic() > deadline:
                    raise
            time.sleep(0.1)

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

    def _label(self, form: Form) -> LabelAnswer:
        return read_label_answer(self.base_url, self._send("POST", "/label", form))

    def _detect(self, parts: Parts) -> DetectAnswer:
        content = self._send("POST", "/detect", parts)
        answer = read_answer(self.base_url, content, DetectAnswer, "an answer to /detect")
        asked = sum(field == "image" for field, _ in parts)
        if len(answer.images) != asked:
            raise UnexpectedAnswerError(
                self.base_url, f"it answers {len(answer.images)} images, {asked} were sent."
            )
        return answer

    def _answers_ok(self, path: str) -> bool:
        try:
            self._send("GET", path)
        except ServiceError:
            return False
        return True

    def _send(self, method: str, path: str, form: Form | Parts | None = None) -> bytes:
        """The body of a success. Raises ServiceError for everything else."""
        response = self._exchange(method, path, form)
        if not response.is_success:
            raise problem_error(self.base_url, response.status_code, response.content)
        return response.content

    def _exchange(self, method: str, path: str, form: Form | Parts | None) -> httpx.Response:
        for attempt in range(1, _ATTEMPTS + 1):
            try:
                return self._http.request(method, path, files=form, headers={"Accept": "application/json"})
            except _BROKEN_CONNECTION as error:
                if attempt == _ATTEMPTS:
                    raise self._unreachable(error) from None
            except httpx.TimeoutException as error:
                raise ServiceUnreachableError(
                    self.base_url, f"no answer in time ({type(error).__name__})."
                ) from None
            except (httpx.RequestError, httpx.InvalidURL) as error:
                raise self._unreachable(error) from None
        raise AssertionError("the last attempt returns or raises")

    def _unreachable(self, error: Exception) -> ServiceUnreachableError:
        return ServiceUnreachableError(
            self.base_url, f"no boxlift service answers ({error}). Start one with: boxlift serve"
        )
