"""What became of a run, counted and as text."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from boxlift_client.job import FrameReport, Outcome

# A run has a million frames: those beyond are counted, and the ledger has them all.
_MOST_FRAMES_KEPT = 1000
_MOST_FRAMES_LISTED = 50
_MOST_WARNINGS_LISTED = 3


@dataclass
class RunSummary:
    """Frames per outcome, prompts per result, the first frames that have no labels, and that warn.

    frames: earlier runs' included; `before` of them. results: of this run. examples: result -> the first
    frame by name that had it, and the sentence there. unlabelled: the first thousand as they came. warned:
    the first three by name, of `warnings` frames. seconds: of the run. noun: what the text calls that which
    has a result.
    """

    frames: Counter[Outcome] = field(default_factory=Counter)
    before: int = 0
    results: Counter[str] = field(default_factory=Counter)
    examples: dict[str, tuple[str, str]] = field(default_factory=dict)
    unlabelled: list[FrameReport] = field(default_factory=list)
    warned: list[FrameReport] = field(default_factory=list)
    warnings: int = 0
    seconds: float = 0.0
    noun: str = "prompt"

    def add(self, report: FrameReport) -> None:
        """Count one frame of this run."""
        self._count(report.outcome, report)
        if report.warnings:
            self.warnings += 1
            # The first by name: the same whatever the order in which frames finish.
            first = sorted([*self.warned, report], key=lambda report: report.frame)
            self.warned = first[:_MOST_WARNINGS_LISTED]
        for result, sentence in report.results:
            self.results[result] += 1
            example = (report.frame, sentence)
            self.examples[result] = min(self.examples.get(result, example), example)

    def add_earlier(self, outcome: Outcome, report: FrameReport | None = None) -> None:
        """Count one frame of an earlier run; `report` where it has no labels."""
        self.before += 1
        self._count(outcome, report)

    def _count(self, outcome: Outcome, report: FrameReport | None) -> None:
        self.frames[outcome] += 1
        if outcome is not Outcome.LABELLED and report and len(self.unlabelled) < _MOST_FRAMES_KEPT:
            self.unlabelled.append(report)

    @property
    def counted(self) -> int:
        """Frames of this run."""
        return self.frames.total() - self.before

    @property
    def complete(self) -> bool:
        """Whether no frame failed (skipped ones had nothing to be labelled from)."""
        return self.frames[Outcome.FAILED] == 0

    def text(self) -> str:
        """Plain text: frames, prompts by result with a sentence each, warnings, and what has no labels."""
        total = self.frames.total()
        head = ", ".join(f"{self.frames[outcome]} {outcome}" for outcome in Outcome)
        pace = f", {self.counted / self.seconds:.1f} a second" if self.seconds > 0 and self.counted else ""
        lines = [f"{counted(total, 'frame')}: {head}; {self.seconds:.1f} s{pace}."]
        if self.before:
            lines.append(f"{counted(self.before, 'frame')} of them before this run.")
        lines.append(f"{counted(self.results.total(), self.noun)}{':' if self.results else '.'}")
        for result, count in self.results.most_common():
            frame, sentence = self.examples[result]
            lines.append(f"  {count:6d}  {result:22} e.g. {frame}: {sentence}")
        lines.extend(self._warning_lines())
        listed = sorted(self.unlabelled, key=lambda report: report.frame)[:_MOST_FRAMES_LISTED]
        lines.extend(f"  {report.outcome} {report.frame}: {report.sentence}" for report in listed)
        unlisted = self.frames[Outcome.FAILED] + self.frames[Outcome.SKIPPED] - len(listed)
        if unlisted > 0:
            lines.append(f"  ... and {unlisted} more without labels")
        return "\n".join(lines)

    def _warning_lines(self) -> list[str]:
        if not self.warnings:
            return []
        lines = [f"{counted(self.warnings, 'frame')} with warnings about the calibration:"]
        for report in self.warned:
            lines.extend(f"  {name:22} {report.frame}: {sentence}" for name, sentence in report.warnings)
        if self.warnings > len(self.warned):
            lines.append(f"  ... and {self.warnings - len(self.warned)} more; see the details of the frames")
        return lines


def counted(count: int, noun: str) -> str:
    """A number with its noun, in the plural where it is one."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
