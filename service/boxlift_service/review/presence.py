"""Who looks at which frame right now: known for some seconds, and to this process alone."""

from __future__ import annotations

from dataclasses import dataclass
from time import monotonic

_KNOWN_FOR_S = 30.0
_MOST_SESSIONS = 10_000


@dataclass(frozen=True)
class _Seen:
    label_set: str
    frame: str
    author: str
    at_s: float


class Presence:
    """Sessions by an id of their own; each is where it was seen last."""

    def __init__(self) -> None:
        self._seen: dict[str, _Seen] = {}

    def seen(self, session: str, label_set: str, frame: str, author: str) -> list[dict[str, str]]:
        """Note where a session is; returns who else is in the label set: frame and author of each."""
        now_s = monotonic()
        self._seen = {key: each for key, each in self._seen.items() if now_s - each.at_s < _KNOWN_FOR_S}
        if session in self._seen or len(self._seen) < _MOST_SESSIONS:
            self._seen[session] = _Seen(label_set, frame, author, now_s)
        return [
            {"frame": each.frame, "author": each.author}
            for key, each in self._seen.items()
            if key != session and each.label_set == label_set
        ]
