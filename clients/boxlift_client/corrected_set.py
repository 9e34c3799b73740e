"""The label set that corrections make of another: every frame with what people said about its boxes."""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass, field
from pathlib import Path

from boxlift.corrections.applied import corrected
from boxlift.corrections.correction import Correction, Verdict
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
    """What went into a corrected label set. verdicts: objects per verdict; authors: objects per author."""

    frames: int = 0
    objects: int = 0
    verdicts: Counter[Verdict] = field(default_factory=Counter)
    authors: Counter[str] = field(default_factory=Counter)

    def text(self) -> str:
        """Plain text, a line each."""
        said = self.verdicts.total()
        lines = [f"{counted(self.frames, 'frame')}, {counted(self.objects, 'object')}, {said} reviewed:"]
        lines += [f"  {count:6d}  {verdict}" for verdict, count in self.verdicts.most_common()]
        lines += [f"  {count:6d}  by {author}" for author, count in self.authors.most_common()]
        return "\n".join(lines)


def write_corrected_set(
    label_set: Path, out: Path, url: str | None = None, name: str | None = None
) -> CorrectedSummary:
    """Write to `out` the labels of `label_set` with the corrections laid over them, and their history.

    url: the store, where it is not beside the labels; name: what the label set is called there. OUT has
    the manifest of LABELS, and corrections.jsonl: everything that was ever said. LABELS stays as it is.
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
    summary = CorrectedSummary()
    for details in read_frames_of(label_set):
        corrections = of_frame.get(details.frame, {})
        write_label_files(out, details.frame, corrected(details, corrections))
        summary.frames += 1
        summary.objects += len(details.objects)
        for each in corrections.values():
            if each.opinion.verdict is not Verdict.OPEN:
                summary.verdicts[each.opinion.verdict] += 1
                summary.authors[each.author] += 1
    write_whole(out / HISTORY, "".join(f"{each.model_dump_json()}\n" for each in history).encode())
    write_whole(out / MANIFEST, manifest.text().encode())
    return summary
