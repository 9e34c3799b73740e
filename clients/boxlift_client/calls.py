"""Everything that can be asked of a service, as steps (http_exchange) for Client and AsyncClient to take.

What is sent is built in label_request and detect_request, what comes back is read in label_answer,
detect_answer and batch; Client documents the calls.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from time import monotonic
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Calibration
from boxlift.errors import BoxliftError, OptionsError
from boxlift.frame import Frame, Prompt
from boxlift.settings import LabellerSettings
from boxlift_client.batch import Batch, FrameOutcome, Item, PackedFrame
from boxlift_client.detect_answer import DetectAnswer
from boxlift_client.detect_request import parts_of_files, parts_of_image
from boxlift_client.errors import (
    ServiceError,
    ServiceFailedError,
    ServiceUnreachableError,
    UnexpectedAnswerError,
)
from boxlift_client.http_exchange import Pause, Request, Steps, exchange, httpx, jittered
from boxlift_client.label_answer import LabelAnswer, check_settings, read_answer, read_label_answer
from boxlift_client.label_request import FrameFiles, form_of_files, form_of_frame
from boxlift_client.request_parts import MSGPACK, TEXT, File, Form, Parts, packed

API_KEY_VARIABLE = "BOXLIFT_API_KEY"
Encoding = Literal["msgpack", "multipart"]
HttpClient = TypeVar("HttpClient", httpx.Client, httpx.AsyncClient)

_LONGEST_CONNECTING_S = 10.0
_UNNAMED = "frame"
# How long until a frame is sent again that the service had no room for.
_ROOM_AGAIN_S = 1.0


class Calls:
    """The calls to the service at `url`. Raises OptionsError for an API key that no header can carry."""

    def __init__(
        self, url: str, timeout_s: float, api_key: str | None, patience_s: float, encoding: Encoding
    ) -> None:
        self.url = url.rstrip("/")
        self._timeout_s = timeout_s
        self._patience_s = patience_s
        self._encoding = encoding
        self._api_key = api_key if api_key is not None else os.environ.get(API_KEY_VARIABLE, "")
        if not all("!" <= character <= "~" for character in self._api_key):
            raise OptionsError(
                "api_key", "it has characters that no key has.", f"See also the variable {API_KEY_VARIABLE}."
            )

    def http(self, client_type: Callable[..., HttpClient]) -> HttpClient:
        """The HTTP client that takes the steps. Raises ServiceUnreachableError where the URL is no URL."""
        headers = {"Accept": "application/json", "X-Request-Timeout": f"{self._timeout_s:g}"}
        if self._api_key:
            headers["Authorization"] = f"Bearer {self._api_key}"
        timeout = httpx.Timeout(self._timeout_s, connect=min(self._timeout_s, _LONGEST_CONNECTING_S))
        try:
            return client_type(base_url=self.url, timeout=timeout, headers=headers)
        except httpx.InvalidURL as error:
            raise ServiceUnreachableError(self.url, f"this is no URL ({error}).") from None

    def label(self, frame: Frame, settings: LabellerSettings, detect: bool) -> Steps[LabelAnswer]:
        answer = yield from self._label(form_of_frame(frame, settings, detect=detect))
        check_settings(self.url, answer, settings.fingerprint())
        return answer

    def label_files(self, files: FrameFiles) -> Steps[LabelAnswer]:
        return (yield from self._label(form_of_files(files)))

    def detect(
        self,
        image: NDArray[np.uint8],
        calibration: Calibration,
        prompts: Sequence[Prompt] | None,
        min_score: float | None,
        name: str,
    ) -> Steps[DetectAnswer]:
        return (yield from self._detect(parts_of_image(image, calibration, prompts, min_score, name)))

    def detect_files(
        self,
        images: Sequence[File],
        calibs: Sequence[File],
        prompts: Sequence[Sequence[Prompt]] | None,
        min_score: float | None,
        names: Sequence[str] | None,
    ) -> Steps[DetectAnswer]:
        return (yield from self._detect(parts_of_files(images, calibs, prompts, min_score, names)))

    def answers_ok(self, path: str) -> Steps[bool]:
        """Whether a GET succeeds. Raises nothing."""
        try:
            yield from exchange(self.url, Request("GET", path))
        except ServiceError:
            return False
        return True

    def wait_until_ready(self, timeout_s: float) -> Steps[None]:
        until = monotonic() + timeout_s
        while True:
            try:
                yield from exchange(self.url, Request("GET", "/readyz"))
                break
            except ServiceFailedError:
                if monotonic() > until:
                    raise
            yield Pause(0.1)
        # A probe needs no key; this does.
        yield from exchange(self.url, Request("GET", "/models"), self._patience_s)

    def models(self) -> Steps[dict[str, Any]]:
        """What GET /models answers."""
        content = yield from exchange(self.url, Request("GET", "/models"), self._patience_s)
        try:
            answer = json.loads(content)
        except ValueError:
            answer = None
        if not isinstance(answer, dict) or "labellers" not in answer:
            raise UnexpectedAnswerError(self.url, "GET /models answers no list of models.")
        return answer

    def pack(self, index: int, frame: Frame | FrameFiles, settings: LabellerSettings, detect: bool) -> Item:
        """A frame of a batch as it is sent, or its outcome where it cannot be."""
        name, fingerprint = _name_of(frame), None
        try:
            if isinstance(frame, Frame):
                form, fingerprint = form_of_frame(frame, settings, detect=detect), settings.fingerprint()
            else:
                form = form_of_files(frame)
        except BoxliftError as error:
            return FrameOutcome(index, name, error=error)
        named: Form = {"name": (None, name.encode(), TEXT)}
        return PackedFrame(index, name, packed(named | form), fingerprint)

    def label_batch(self, items: Sequence[Item]) -> Steps[list[FrameOutcome]]:
        """One request, again for the frames that the service did not come to, or had no room for."""
        until = monotonic() + self._patience_s
        headers = {"Content-Type": MSGPACK, "Accept": "application/x-ndjson"}
        batch = Batch(self.url, items)
        while not batch.is_done:
            request = Request("POST", "/label:batch", content=batch.body(), headers=headers)
            content = yield from exchange(self.url, request, self._patience_s)
            batch.read(content, last_time=monotonic() > until)
            if not batch.is_done:
                yield Pause(jittered(_ROOM_AGAIN_S))
        return batch.outcomes

    def _label(self, form: Form) -> Steps[LabelAnswer]:
        if self._encoding == "msgpack":
            request = Request("POST", "/label", content=packed(form), headers={"Content-Type": MSGPACK})
        else:
            request = Request("POST", "/label", form)
        return read_label_answer(self.url, (yield from exchange(self.url, request, self._patience_s)))

    def _detect(self, parts: Parts) -> Steps[DetectAnswer]:
        request = Request("POST", "/detect", parts)
        content = yield from exchange(self.url, request, self._patience_s)
        answer = read_answer(self.url, content, DetectAnswer, "an answer to /detect")
        asked = sum(field == "image" for field, _ in parts)
        if len(answer.images) != asked:
            raise UnexpectedAnswerError(
                self.url, f"it answers {len(answer.images)} images, {asked} were sent."
            )
        return answer


def _name_of(frame: Frame | FrameFiles) -> str:
    """As the service would name a frame that has no name; in a batch all have one."""
    if frame.name is not None:
        return frame.name
    stem = Path(frame.points).stem if isinstance(frame.points, str | Path) else ""
    return stem if stem and stem.isprintable() else _UNNAMED
