"""What is in a label set, counted; and which of its frames are worth a look."""

from __future__ import annotations

import heapq
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from boxlift.corrections.worth import worth_a_look
from boxlift.formats.details import FrameDetails

DEPTH_STEP_M = 10
_SIZE_QUANTILES = (0.05, 0.5, 0.95)


@dataclass(frozen=True)
class SizeRow:
    """The sizes of a class's boxes, metres: (5 %, median, 95 %) of length, width and height."""

    category: str
    boxes: int
    length_m: tuple[float, ...]
    width_m: tuple[float, ...]
    height_m: tuple[float, ...]


@dataclass
class Contents:
    """Counts over the frames that were added.

    results: class -> result -> objects. sentences: of each result, the first. scores: boxes per tenth of the
    score. depths: boxes per ten metres.
    flags: boxes per flag. warnings: frames per doubt about the calibration. worth: (worth, frame) of the
    frames most worth a look, by the sum over their objects.
    """

    kept_frames: int
    frames: int = 0
    objects: int = 0
    boxes: int = 0
    results: defaultdict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))
    sentences: dict[str, str] = field(default_factory=dict)
    scores: Counter[int] = field(default_factory=Counter)
    depths: Counter[int] = field(default_factory=Counter)
    flags: Counter[str] = field(default_factory=Counter)
    warnings: Counter[str] = field(default_factory=Counter)
    worth: list[tuple[float, str]] = field(default_factory=list)
    _sizes: defaultdict[str, list[tuple[float, float, float]]] = field(
        default_factory=lambda: defaultdict(list)
    )

    def add(self, details: FrameDetails) -> None:
        """Count one frame."""
        self.frames += 1
        self.objects += len(details.objects)
        self.warnings.update({warning.name for warning in details.warnings})
        for item in details.objects:
            self.results[item.category][item.result] += 1
            self.sentences.setdefault(item.result, item.sentence)
            if item.box is None:
                continue
            self.boxes += 1
            self.scores[min(int(10 * item.score), 9)] += 1
            self.depths[int(max(item.box.center_cam[2], 0) // DEPTH_STEP_M)] += 1
            self.flags.update(item.flags)
            size = (item.box.length_m, item.box.width_m, item.box.height_m)
            self._sizes[item.category].append(size)
        worth = sum(worth_a_look(item) for item in details.objects)
        heapq.heappush(self.worth, (round(worth, 4), details.frame))
        if len(self.worth) > self.kept_frames:
            heapq.heappop(self.worth)

    def sizes(self) -> list[SizeRow]:
        """A row per class that has boxes."""
        rows = []
        for category, sizes in sorted(self._sizes.items()):
            quantiles = np.quantile(np.array(sizes), _SIZE_QUANTILES, axis=0).T.tolist()
            length, width, height = map(tuple, quantiles)
            rows.append(SizeRow(category, len(sizes), length, width, height))
        return rows

    def frames_worth_a_look(self) -> list[str]:
        """Those most worth it first."""
        return [frame for _, frame in sorted(self.worth, key=lambda each: (-each[0], each[1]))]


@dataclass(frozen=True)
class Timing:
    """Seconds a frame took to label: of the ledger's rows that have labels."""

    frames: int
    median_s: float
    p95_s: float
    longest_s: float
    longest: str


def timing_of(seconds: Iterable[tuple[str, float]]) -> Timing | None:
    """From (frame, seconds) of every labelled frame; None without any."""
    rows = list(seconds)
    if not rows:
        return None
    values = np.array([each for _, each in rows])
    at = int(values.argmax())
    return Timing(
        len(rows), float(np.median(values)), float(np.quantile(values, 0.95)), float(values[at]), rows[at][0]
    )
