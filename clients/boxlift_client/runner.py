"""Label a dataset with an engine and count what became of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from time import perf_counter

from boxlift.datasets import find_labels, open_source
from boxlift.errors import OptionsError
from boxlift_client.engines import Engine
from boxlift_client.job import FrameReport, LabelJob, Outcome


@dataclass
class RunSummary:
    """What became of a run: frames per outcome, prompts per result, and every frame that has no labels."""

    frames: Counter[Outcome] = field(default_factory=Counter)
    results: Counter[str] = field(default_factory=Counter)
    examples: dict[str, tuple[str, str]] = field(default_factory=dict)
    unlabelled: list[FrameReport] = field(default_factory=list)
    seconds: float = 0.0

    def add(self, report: FrameReport) -> None:
        """Count one frame."""
        self.frames[report.outcome] += 1
        if report.outcome is not Outcome.LABELLED:
            self.unlabelled.append(report)
        for result, sentence in report.results:
            self.results[result] += 1
            # Of the first frame by name: the same whatever the order in which frames finish.
            example = (report.frame, sentence)
            self.examples[result] = min(self.examples.get(result, example), example)

    @property
    def complete(self) -> bool:
        """Whether no frame failed (skipped ones had nothing to be labelled from)."""
        return self.frames[Outcome.FAILED] == 0


def label_dataset(
    job: LabelJob,
    engine: Engine,
    names: Sequence[str] | None = None,
    on_report: Callable[[FrameReport], None] = lambda _: None,
) -> RunSummary:
    """Label the frames `names` (all where None) of a job's source; `on_report` hears of each as it ends.

    A frame that cannot be labelled is listed in the summary and costs no other. Raises BoxliftError
    where nothing can be labelled: no dataset, no prompts, no service.
    """
    start = perf_counter()
    source = open_source(job.source)
    find_labels(job.prompts, source)
    if job.masks is not None and not job.masks.is_dir():
        raise OptionsError("masks", f"there is no folder {str(job.masks)!r}.", "Check the path.")
    chosen = source.names if names is None else list(dict.fromkeys(names))
    summary = RunSummary()
    for report in engine.run(job, chosen):
        summary.add(report)
        on_report(report)
    summary.unlabelled.sort(key=lambda report: report.frame)
    summary.seconds = perf_counter() - start
    return summary
