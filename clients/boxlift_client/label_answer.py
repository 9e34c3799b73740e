"""What a service answers, read."""

from __future__ import annotations

import json
from collections.abc import Mapping
from http import HTTPStatus
from typing import Any, TypeVar

from pydantic import BaseModel, Field, ValidationError

from boxlift.formats.details import FrameDetails, kitti_text
from boxlift_client.errors import (
    NotAuthorizedError,
    Problem,
    RequestRefusedError,
    ServiceBusyError,
    ServiceFailedError,
    ServiceProblemError,
    UnexpectedAnswerError,
)

Answer = TypeVar("Answer", bound=BaseModel)


class LabelAnswer(FrameDetails):
    """The labels of one frame, and with what they were made. Members of later versions are ignored."""

    dropped_points: int = Field(description="Points that were left out: not finite, or beyond 100 km.")
    preset: str = Field(description="Preset that the settings started from.")
    settings_fingerprint: str = Field(description="Changes when any setting of the labeller does.")
    api_version: str = Field(description="Version of the HTTP interface.")
    boxlift_version: str = Field(description="Version of the package.")

    @property
    def details(self) -> FrameDetails:
        """What became of every prompt and what the frame warns of, without the rest."""
        return FrameDetails(
            frame=self.frame,
            objects=self.objects,
            warnings=self.warnings,
            model_digest=self.model_digest,
        )

    @property
    def kitti_text(self) -> str:
        """The boxes as KITTI result lines; empty for none."""
        return kitti_text(self)


def read_label_answer(url: str, content: bytes) -> LabelAnswer:
    """The body of a success. Raises UnexpectedAnswerError."""
    return read_answer(url, content, LabelAnswer, "a label answer")


def read_answer(url: str, content: bytes, answer_type: type[Answer], what: str) -> Answer:
    """The body of a success as `answer_type`, which errors call `what`. Raises UnexpectedAnswerError."""
    try:
        return answer_type.model_validate_json(content)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise UnexpectedAnswerError(
            url,
            f"the answer is not {what} ({where or 'body'}: {first['msg']}). Is it a boxlift service, "
            "and of this version?",
        ) from None


def check_settings(url: str, answer: LabelAnswer, fingerprint: str) -> None:
    """Raises UnexpectedAnswerError where the labels were made with other settings than were asked for."""
    if answer.settings_fingerprint != fingerprint:
        raise UnexpectedAnswerError(
            url,
            f"the service labelled with the settings {answer.settings_fingerprint}, not with "
            f"{fingerprint} as asked: it is of another version ({answer.boxlift_version}).",
        )


def problem_error(url: str, status: int, content: bytes) -> ServiceProblemError:
    """The body of a refusal or failure as the exception to raise; never raises itself."""
    try:
        members: Any = json.loads(content)
    except ValueError:
        members = None
    if not isinstance(members, dict):
        members = {"detail": content[:200].decode("utf-8", "replace")}
    return error_of_problem(url, status, members)


def error_of_problem(url: str, status: int, members: Mapping[str, Any]) -> ServiceProblemError:
    """The members of a problem document as the exception to raise."""
    known = ("type", "title", "detail", "field", "problem", "remedy")
    texts = {key: members[key] for key in known if isinstance(members.get(key), str)}
    return _error_type(status)(url, Problem(status, **texts))


def _error_type(status: int) -> type[ServiceProblemError]:
    if status == HTTPStatus.UNAUTHORIZED:
        return NotAuthorizedError
    if status == HTTPStatus.TOO_MANY_REQUESTS:
        return ServiceBusyError
    return RequestRefusedError if 400 <= status < 500 else ServiceFailedError
