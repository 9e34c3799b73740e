"""How a run makes a folder a label set, or joins the one that is there.

A label set is made one way: the fingerprint of its manifest covers all that labels depend on but the frames
themselves, and a run with another one is refused.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from boxlift.errors import OptionsError
from boxlift.label_sets.manifest import MANIFEST, Manifest, SourceEntry, read_manifest
from boxlift.storage import is_folder, write_whole
from boxlift_client.engines import LabellerIdentity
from boxlift_client.job import LabelJob

if TYPE_CHECKING:
    from boxlift.storage import AnyPath


def manifest_of(job: LabelJob, identity: LabellerIdentity, layout: str) -> Manifest:
    """That of a job on its own."""
    return Manifest.made(
        (SourceEntry.of(job.source, layout),),
        version=identity.version,
        prompts=job.prompts,
        masks=None if job.masks is None else job.masks.name,
        detector_digest=identity.detector_digest,
        settings=job.settings.model_dump(mode="json"),
    )


def join_label_set(job: LabelJob, identity: LabellerIdentity, layout: str) -> tuple[Manifest, str]:
    """Make `job.out` a label set, or join the one that is there: its manifest, and the source's id.

    Raises OptionsError where what is there was made otherwise.
    """
    own = manifest_of(job, identity, layout)
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
