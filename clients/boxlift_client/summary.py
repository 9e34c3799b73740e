"""What became of a run, counted and as text."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from boxlift_client.job import FrameReport, Outcome

_MOST_FRAMES_LISTED = 50
_MOST_WARNINGS_LISTED = 3


@dataclass
class RunSummary:
    """Frames per outcome, prompts per result, every frame that has no labels, and every one that warns.

    examples: result -> the first frame by name that had it, and the sentence there. seconds: of the run.
    noun: what the text calls that which has a result.
    """

    frames: Counter[Outcome] = field(default_factory=Counter)
    results: Counter[str] = field(default_factory=Counter)
    examples: dict[str, tuple[str, str]] = field(default_factory=dict)
    unlabelled: list[FrameReport] = field(default_factory=list)
    warned: list[FrameReport] = field(default_factory=list)
    seconds: float = 0.0
    noun: str = "prompt"

    def add(self, report: FrameReport) -> None:
        """Count one frame."""
        self.frames[report.outcome] += 1
        if report.outcome is not Outcome.LABELLED:
            self.unlabelled.append(report)
        if report.warnings:
            self.warned.append(report)
        for result, sentence in report.results:
            self.results[result] += 1
            # The first by name: the same whatever the order in which frames finish.
            example = (report.frame, sentence)
            self.examples[result] = min(self.examples.get(result, example), example)

    @property
    def complete(self) -> bool:
        """Whether no frame failed (skipped ones had nothing to be labelled from)."""
        return self.frames[Outcome.FAILED] == 0

    def text(self) -> str:
        """Plain text: frames, prompts by result with a sentence each, warnings, and what has no labels."""
        total = self.frames.total()
        head = ", ".join(f"{self.frames[outcome]} {outcome}" for outcome in Outcome)
        pace = f", {total / self.seconds:.1f} a second" if self.seconds > 0 else ""
        lines = [f"{_counted(total, 'frame')}: {head}; {self.seconds:.1f} s{pace}."]
        lines.append(f"{_counted(self.results.total(), self.noun)}{':' if self.results else '.'}")
        for result, count in self.results.most_common():
            frame, sentence = self.examples[result]
            lines.append(f"  {count:6d}  {result:22} e.g. {frame}: {sentence}")
        lines.extend(self._warning_lines())
        listed = sorted(self.unlabelled, key=lambda report: report.frame)[:_MOST_FRAMES_LISTED]
        lines.extend(f"  {report.outcome} {report.frame}: {report.sentence}" for report in listed)
        if len(self.unlabelled) > _MOST_FRAMES_LISTED:
            lines.append(f"  ... and {len(self.unlabelled) - _MOST_FRAMES_LISTED} more without labels")
        return "\n".join(lines)

    def _warning_lines(self) -> list[str]:
        if not self.warned:
            return []
        warned = sorted(self.warned, key=lambda report: report.frame)
        lines = [f"{_counted(len(warned), 'frame')} with warnings about the calibration:"]
        for report in warned[:_MOST_WARNINGS_LISTED]:
            lines.extend(f"  {name:22} {report.frame}: {sentence}" for name, sentence in report.warnings)
        if len(warned) > _MOST_WARNINGS_LISTED:
            lines.append(
                f"  ... and {len(warned) - _MOST_WARNINGS_LISTED} more; see the details of the frames"
            )
        return lines


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
