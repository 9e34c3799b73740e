"""Whether the service takes on more work, or is about to end."""

from __future__ import annotations


class Lifecycle:
    """draining: the service was told to end; it still answers, and asks to be left out.

    ending: its port is closed; what was accepted is finished.
    """

    def __init__(self) -> None:
        self.draining = False
        self.ending = False
