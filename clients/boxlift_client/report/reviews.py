"""What people said about the boxes of a label set, for its report."""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from boxlift.corrections.correction import Opinion, Verdict
from boxlift.corrections.lessons import Lesson, Share, lesson_of, shares_by_flag, shares_by_score
from boxlift.corrections.store import FILE_NAME, CorrectionStore, default_url
from boxlift.formats.details import FrameDetails

if TYPE_CHECKING:
    from boxlift.storage import AnyPath


@dataclass
class Reviews:
    """Verdicts over the frames that were added.

    opinions: frame -> object -> what was said of a machine's label set. verdicts: class -> verdict ->
    objects, in a corrected label set by its own details. lessons: what the opinions say of the machine's
    boxes.
    """

    opinions: dict[str, dict[int, Opinion]] = field(default_factory=dict)
    verdicts: defaultdict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))
    lessons: list[Lesson] = field(default_factory=list)

    @classmethod
    def of(cls, label_set: AnyPath) -> Reviews:
        """With the corrections that lie in a label set on this machine. Raises OptionsError."""
        opinions: defaultdict[str, dict[int, Opinion]] = defaultdict(dict)
        if isinstance(label_set, Path) and (label_set / FILE_NAME).is_file():
            store = CorrectionStore(default_url(label_set), label_set.name)
            try:
                for each in store.latest():
                    opinions[each.frame][each.object_index] = each.opinion
            finally:
                store.close()
        return cls(dict(opinions))

    def add(self, details: FrameDetails) -> None:
        """Count one frame."""
        opinions = self.opinions.get(details.frame, {})
        for item in details.objects:
            opinion = opinions.get(item.index)
            if item.review is not None:
                self.verdicts[item.category][item.review.verdict] += 1
            elif opinion is not None and opinion.verdict is not Verdict.OPEN:
                self.verdicts[item.category][opinion.verdict.value] += 1
                if (lesson := lesson_of(item, opinion)) is not None:
                    self.lessons.append(lesson)

    def verdict_table(self) -> list[list[object]]:
        """A head and a row per class; empty where nobody said anything."""
        if not self.verdicts:
            return []
        kinds = [each.value for each in Verdict if each is not Verdict.OPEN]
        rows = [
            [category, *(counts[kind] for kind in kinds)]
            for category, counts in sorted(self.verdicts.items())
        ]
        return [["class", *kinds], *rows]

    def shares(self) -> list[Share]:
        """How often boxes were right: by flag, then by score; empty without lessons."""
        return [*shares_by_flag(self.lessons), *shares_by_score(self.lessons)] if self.lessons else []
