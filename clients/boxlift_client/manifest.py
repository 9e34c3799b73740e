"""manifest.json: how a label set was made, and what its frames are of.

A label set is made one way: the fingerprint covers all that labels depend on but the frames themselves, and a
run with another one is refused. The file holds no times and no machine, so that every shard of a run writes
the same bytes.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, ConfigDict, ValidationError

from boxlift.errors import LabelFormatError, OptionsError
from boxlift.storage import is_folder, read_whole, write_whole
from boxlift_client.engines import LabellerIdentity
from boxlift_client.job import LabelJob

if TYPE_CHECKING:
    from boxlift.storage import AnyPath

MANIFEST = "manifest.json"
_FORMAT = 1


class SourceEntry(BaseModel):
    """A data set whose frames are in the label set. `id` stays where the data set moves, and `path` does."""

    model_config = ConfigDict(frozen=True)

    id: str
    path: str
    layout: str


class Manifest(BaseModel):
    """How a label set was made.

    version: of the boxlift that labels. prompts, masks: as they were named. detector_digest: SHA-256 of the
    detector's file, where it found the prompts. tracking: how it was tracked from a label set that was made
    so; None for one that is not tracked.
    """

    model_config = ConfigDict(frozen=True)

    format: int = _FORMAT
    fingerprint: str
    version: str
    prompts: str
    masks: str | None
    detector_digest: str | None
    settings: dict[str, Any]
    sources: tuple[SourceEntry, ...]
    tracking: dict[str, Any] | None = None

    @classmethod
    def of(cls, job: LabelJob, identity: LabellerIdentity, layout: str) -> Manifest:
        """That of a job on its own."""
        made: dict[str, Any] = {
            "version": identity.version,
            "prompts": job.prompts,
            "masks": None if job.masks is None else job.masks.name,
            "detector_digest": identity.detector_digest,
            "settings": job.settings.model_dump(mode="json"),
        }
        return cls(fingerprint=_fingerprint(made), sources=(_entry(job.source, layout),), **made)

    def tracked(self, tracking: dict[str, Any]) -> Manifest:
        """That of the label set that is tracked from this one."""
        fingerprint = _fingerprint({"labels": self.fingerprint, "tracking": tracking})
        return self.model_copy(update={"fingerprint": fingerprint, "tracking": tracking})

    def source_id(self, source: AnyPath) -> str | None:
        """The id of a data set; None where it is none of the sources."""
        path = _location(source)
        return next((entry.id for entry in self.sources if entry.path == path), None)

    def text(self) -> str:
        """The text of the file."""
        return self.model_dump_json(indent=2) + "\n"


def read_manifest(out: AnyPath) -> Manifest | None:
    """The manifest of the label set in `out`; None where there is none. Raises LabelFormatError."""
    path = out / MANIFEST
    try:
        return Manifest.model_validate_json(read_whole(path))
    except FileNotFoundError:
        return None
    except ValidationError as error:
        problem = f"the file is no manifest of a label set ({error.errors()[0]['msg']})."
        raise LabelFormatError(str(path), problem, "Restore it, or give another --out.") from None


def join_label_set(job: LabelJob, identity: LabellerIdentity, layout: str) -> tuple[Manifest, str]:
    """Make `job.out` a label set, or join the one that is there: its manifest, and the source's id.

    Raises OptionsError where what is there was made otherwise.
    """
    own = Manifest.of(job, identity, layout)
    there = read_manifest(job.out)
    if there is None:
        # Asked in this order, for another shard may be writing: its manifest comes before its first label.
        if _holds_files(job.out / "data") and (there := read_manifest(job.out)) is None:
            raise OptionsError(
                "out", f"{str(job.out)!r} holds labels without a {MANIFEST}.", "Give an empty or new folder."
            )
        there = there or own
    if there.fingerprint != own.fingerprint:
        raise OptionsError(
            "out",
            f"the labels in {str(job.out)!r} were made otherwise ({_differences(there, own)}).",
            "Give another --out, or the same options and version as before.",
        )
    if (known := there.source_id(job.source)) is None or not (job.out / MANIFEST).is_file():
        (entry,) = own.sources
        others = tuple(each for each in there.sources if each.id != entry.id)
        there = there.model_copy(update={"sources": (*others, entry)})
        write_whole(job.out / MANIFEST, there.text().encode())
        known = entry.id
    return there, known


def join_tracked_set(out: AnyPath, labels: Manifest, tracking: dict[str, Any]) -> None:
    """Make `out` the label set that is tracked from one with the manifest `labels`, or join the one there.

    Raises OptionsError where what is there was made otherwise.
    """
    own = labels.tracked(tracking)
    there = read_manifest(out)
    if there is None and _holds_files(out / "data"):
        raise OptionsError("out", f"{str(out)!r} holds labels without a {MANIFEST}.", "Give an empty folder.")
    if there is not None and there.fingerprint != own.fingerprint:
        raise OptionsError(
            "out",
            f"the labels in {str(out)!r} were made otherwise ({_differences(there, own)}).",
            "Give another --out, or the same label set, options and version as before.",
        )
    if there != own:
        write_whole(out / MANIFEST, own.text().encode())


def _fingerprint(made: dict[str, Any]) -> str:
    canonical = json.dumps(made, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(canonical.encode()).hexdigest()[:16]


def _entry(source: AnyPath, layout: str) -> SourceEntry:
    path = _location(source)
    return SourceEntry(id=hashlib.sha256(path.encode()).hexdigest()[:8], path=path, layout=layout)


def _location(source: AnyPath) -> str:
    return str(source.absolute())


def _holds_files(folder: AnyPath) -> bool:
    """A bucket has no empty folders."""
    if not isinstance(folder, Path):
        return is_folder(folder)
    return folder.is_dir() and next(folder.iterdir(), None) is not None


def _differences(there: Manifest, own: Manifest) -> str:
    """What differs, as `name: there, not here`; the first three."""
    before, after = (_flat(each.model_dump(exclude={"sources", "fingerprint"})) for each in (there, own))
    names = sorted(name for name in before.keys() | after.keys() if before.get(name) != after.get(name))
    told = [f"{name} {before.get(name)!r}, not {after.get(name)!r}" for name in names[:3]]
    return "; ".join(told) + ("; ..." if len(names) > 3 else "")


def _flat(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in values.items():
        flat.update(_flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value})
    return flat
