"""Many frames in one request: how they are put together, and what POST /label:batch says of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from boxlift.errors import BoxliftError
from boxlift_client.errors import ServiceProblemError, UnexpectedAnswerError
from boxlift_client.label_answer import LabelAnswer, check_settings, error_of_problem, read_answer

# A whole request is sent before its answer is read. With these bounds that is soon, and what the service
# answers meanwhile is little.
_MOST_FRAMES = 16
_MOST_BYTES = 16 * 2**20

_WHAT = "an answer to /label:batch"


@dataclass(frozen=True)
class FrameOutcome:
    """What became of a frame of a batch: its labels, or why there are none.

    index: its place among the frames that were given, from 0.
    """

    index: int
    name: str
    answer: LabelAnswer | None = None
    error: BoxliftError | None = None


@dataclass(frozen=True)
class PackedFrame:
    """A frame as it is sent. fingerprint: of the settings that it is to be labelled with, where known."""

    index: int
    name: str
    data: bytes
    fingerprint: str | None = None


# What a batch is made of: a frame that is sent, or what became of one that cannot be.
Item = PackedFrame | FrameOutcome


class FrameGroups:
    """Puts frames together in requests of bounded size, within which no name comes twice."""

    def __init__(self) -> None:
        self._items: list[Item] = []

    def add(self, item: Item) -> list[list[Item]]:
        """The group that is full without this frame; none yet."""
        items = [*self._items, item]
        fits = len(items) <= _MOST_FRAMES and sum(map(_size, items)) <= _MOST_BYTES
        if len(items) == 1 or (fits and item.name not in {other.name for other in self._items}):
            self._items = items
            return []
        full, self._items = self._items, [item]
        return [full]

    def rest(self) -> list[list[Item]]:
        """The last group; none without frames."""
        return [self._items] if self._items else []


def _size(item: Item) -> int:
    return len(item.data) if isinstance(item, PackedFrame) else 0


class _Line(BaseModel):
    """What the service says of the frame `index` of a request."""

    index: int
    status: int
    answer: LabelAnswer | None = None
    problem: dict[str, Any] = {}


class _End(BaseModel):
    """The last line: without it the answer was cut."""

    frames: int
    complete: bool


def _is_worth_asking_again(error: BoxliftError | None) -> bool:
    """Whether the service had no room for the frame, or ended before it."""
    return isinstance(error, ServiceProblemError) and error.problem.status in (429, 503)


class Batch:
    """The frames of a request, and what becomes of them. `outcomes` are in order of completion."""

    def __init__(self, url: str, items: Sequence[Item]) -> None:
        self.outcomes = [item for item in items if isinstance(item, FrameOutcome)]
        self._url = url
        self._waiting = [item for item in items if isinstance(item, PackedFrame)]

    @property
    def is_done(self) -> bool:
        return not self._waiting

    def body(self) -> bytes:
        """Of the request for the frames that have no outcome yet."""
        return b"".join(frame.data for frame in self._waiting)

    def read(self, content: bytes, *, last_time: bool) -> None:
        """Take the outcomes from an answer to `body`.

        A frame that the service had no room for has none yet, unless this is the last time. Raises
        UnexpectedAnswerError; also where frames were left out, the last time.
        """
        asked, answered = self._waiting, set()
        *lines, last = content.splitlines() or [b""]
        read_answer(self._url, last, _End, _WHAT)
        for line in (read_answer(self._url, line, _Line, _WHAT) for line in lines):
            if not 0 <= line.index < len(asked):
                raise self._unexpected(f"it answers frame {line.index}, {len(asked)} were sent.")
            outcome = self._outcome(asked[line.index], line)
            if last_time or not _is_worth_asking_again(outcome.error):
                answered.add(line.index)
                self.outcomes.append(outcome)
        self._waiting = [frame for index, frame in enumerate(asked) if index not in answered]
        if last_time and self._waiting:
            raise self._unexpected(f"it leaves out frame {self._waiting[0].name!r} of a batch.")

    def _outcome(self, frame: PackedFrame, line: _Line) -> FrameOutcome:
        if line.answer is None:
            error = error_of_problem(self._url, line.status, line.problem)
            return FrameOutcome(frame.index, frame.name, error=error)
        if frame.fingerprint is not None:
            check_settings(self._url, line.answer, frame.fingerprint)
        return FrameOutcome(frame.index, frame.name, line.answer)

    def _unexpected(self, message: str) -> UnexpectedAnswerError:
        return UnexpectedAnswerError(self._url, message)
