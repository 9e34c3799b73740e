"""The label set that corrections make of another: every frame with what people said about its boxes."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from boxlift.corrections.applied import corrected
from boxlift.corrections.correction import Correction, Verdict
from boxlift.corrections.lessons import (
    Lesson,
    Recalibration,
    lesson_of,
    recalibrated,
    shares_by_flag,
    shares_by_score,
)
from boxlift.corrections.store import FILE_NAME, CorrectionStore, default_url
from boxlift.errors import DatasetError, OptionsError
from boxlift.label_sets.files import write_label_files
from boxlift.label_sets.index import read_frames_of
from boxlift.label_sets.manifest import MANIFEST, read_manifest
from boxlift.storage import write_whole
from boxlift_client.summary import counted

CORRECTED = "corrected"
HISTORY = "corrections.jsonl"


@dataclass
class CorrectedSummary:
    """What went into a corrected label set. verdicts: objects per verdict; authors: objects per author.

    lessons: what the verdicts say of the machine's boxes. recalibration: by which others were scored anew.
    """

    frames: int = 0
    objects: int = 0
    verdicts: Counter[Verdict] = field(default_factory=Counter)
    authors: Counter[str] = field(default_factory=Counter)
    lessons: list[Lesson] = field(default_factory=list)
    recalibration: Recalibration | None = None

    def text(self) -> str:
        """Plain text, a line each."""
        said = self.verdicts.total()
        lines = [f"{counted(self.frames, 'frame')}, {counted(self.objects, 'object')}, {said} reviewed:"]
        lines += [f"  {count:6d}  {verdict}" for verdict, count in self.verdicts.most_common()]
        lines += [f"  {count:6d}  by {author}" for author, count in self.authors.most_common()]
        if self.lessons:
            lines.append("Of the machine's boxes, as the verdicts have it (right: IoU above .5):")
            shares = [*shares_by_flag(self.lessons), *shares_by_score(self.lessons)]
            lines += [
                f"  {each.name:18} {each.boxes:5d} boxes  {each.right / each.boxes:5.2f} right  "
                f"{each.mean_score:5.2f} mean score"
                for each in shares
            ]
        if (by := self.recalibration) is not None:
            slope, offset = by.slope, by.offset
            lines.append(f"Scores anew: logistic({slope:.2f} logit(score) {offset:+.2f}).")
        return "\n".join(lines)


def write_corrected_set(
    label_set: Path, out: Path, url: str | None = None, name: str | None = None, *, rescore: bool = False
) -> CorrectedSummary:
    """Write to `out` the labels of `label_set` with the corrections laid over them, and their history.

    url: the store, where it is not beside the labels; name: what the label set is called there. rescore:
    boxes that nobody judged get their score by what the verdicts say of scores. OUT has the manifest of
    LABELS, and corrections.jsonl: everything that was ever said. LABELS stays as it is.
    Raises DatasetError, LabelFormatError, OptionsError, OSError.
    """
    manifest = read_manifest(label_set)
    if manifest is None:
        raise DatasetError(str(label_set), f"it has no {MANIFEST}.", "Give what `boxlift label` wrote.")
    if out.absolute() == label_set.absolute():
        raise OptionsError("out", "these are the machine's labels.", "Give another folder.")
    if url is None and not (label_set / FILE_NAME).is_file():
        raise DatasetError(
            str(label_set), "it has no corrections.", "Make some: boxlift serve --label-sets LABELS."
        )
    store = CorrectionStore(url or default_url(label_set), name or label_set.name)
    try:
        said, history = store.latest(), store.history()
    finally:
        store.close()
    of_frame: defaultdict[str, dict[int, Correction]] = defaultdict(dict)
    for each in said:
        of_frame[each.frame][each.object_index] = each
    for folder in ("data", "details"):
        (out / folder).mkdir(parents=True, exist_ok=True)
    summary = CorrectedSummary(lessons=_lessons(label_set, of_frame))
    if rescore:
        summary.recalibration = recalibrated(summary.lessons)
    for details in read_frames_of(label_set):
        corrections = of_frame.get(details.frame, {})
        write_label_files(out, details.frame, corrected(details, corrections, summary.recalibration))
        summary.frames += 1
        summary.objects += len(details.objects)
        for each in corrections.values():
            if each.opinion.verdict is not Verdict.OPEN:
                summary.verdicts[each.opinion.verdict] += 1
                summary.authors[each.author] += 1
    write_whole(out / HISTORY, "".join(f"{each.model_dump_json()}\n" for each in history).encode())
    write_whole(out / MANIFEST, manifest.text().encode())
    return summary


def _lessons(label_set: Path, of_frame: Mapping[str, Mapping[int, Correction]]) -> list[Lesson]:
    """What was said of boxes that the machine made."""
    lessons = []
    for details in read_frames_of(label_set, sorted(of_frame)):
        for item in details.objects:
            correction = of_frame[details.frame].get(item.index)
            if correction and (lesson := lesson_of(item, correction.opinion)):
                lessons.append(lesson)
    return lessons
