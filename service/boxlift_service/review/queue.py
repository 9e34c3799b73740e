"""The objects of a label set in the order in which they are worth a look."""

from __future__ import annotations

import logging
from dataclasses import asdict, dataclass
from pathlib import Path
from threading import Event, Lock, Thread
from typing import Any

from boxlift.corrections.worth import worth_a_look
from boxlift.errors import BoxliftError
from boxlift.label_sets.index import LabelSetIndex, read_frames_of

_log = logging.getLogger("boxlift_service")


@dataclass(frozen=True)
class QueueEntry:
    """An object in the queue. worth: see boxlift.corrections.worth."""

    frame: str
    index: int
    category: str
    result: str
    score: float
    has_box: bool
    flags: tuple[str, ...]
    worth: float


@dataclass(frozen=True)
class QueueState:
    """How far the details have been read, and the objects so far, those worth most first."""

    frames: int
    frames_read: int
    entries: tuple[QueueEntry, ...]

    def to_json(self, limit: int, done: frozenset[tuple[str, int]]) -> dict[str, Any]:
        """As the page takes it: at most `limit` entries, without those in `done` (frame, index)."""
        left = [each for each in self.entries if (each.frame, each.index) not in done]
        return {
            "frames": self.frames,
            "frames_read": self.frames_read,
            "objects": len(self.entries),
            "left": len(left),
            "entries": [asdict(each) for each in left[:limit]],
        }


class ReviewQueue:
    """Reads the details of a label set in a thread of its own, each file once."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._lock = Lock()
        self._stopped = Event()
        self._thread: Thread | None = None
        self._entries: list[QueueEntry] = []
        self._frames = self._frames_read = 0
        self._known: set[str] = set()
        self._sorted = True

    def state(self, wait_s: float = 0.0) -> QueueState:
        """What is known so far; waits up to `wait_s` for all of it, frames that have come since included."""
        with self._lock:
            if self._thread is None or not self._thread.is_alive():
                self._thread = Thread(target=self._read, name="boxlift-review-queue", daemon=True)
                self._thread.start()
        self._thread.join(wait_s)
        with self._lock:
            if not self._sorted:
                self._entries.sort(key=lambda each: (-each.worth, each.frame, each.index))
                self._sorted = True
            return QueueState(self._frames, self._frames_read, tuple(self._entries))

    def stop(self) -> None:
        """Read no further."""
        self._stopped.set()

    def _read(self) -> None:
        try:
            names = LabelSetIndex.names_in(self._folder)
            self._frames = len(names)
            for name in names:
                if self._stopped.is_set():
                    return
                if name not in self._known:
                    self._known.add(name)
                    self._add(name)
        except (BoxliftError, OSError) as error:
            _log.warning("the label set %s cannot be read: %s", self._folder, error)

    def _add(self, name: str) -> None:
        """One broken file hides no other frame."""
        try:
            (details,) = read_frames_of(self._folder, [name])
        except (BoxliftError, OSError) as error:
            _log.warning("passed over in the review queue: %s", error)
            entries = []
        else:
            entries = [
                QueueEntry(
                    frame=name,
                    index=item.index,
                    category=item.category,
                    result=item.result,
                    score=item.score,
                    has_box=item.box is not None,
                    flags=item.flags,
                    worth=round(worth_a_look(item), 4),
                )
                for item in details.objects
            ]
        with self._lock:
            self._entries += entries
            self._frames_read += 1
            self._sorted = False
