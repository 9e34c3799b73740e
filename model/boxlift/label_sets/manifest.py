"""manifest.json: how a label set was made, and what its frames are of.

The file holds no times and no machine, so that every shard of a run writes the same bytes.
"""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, ConfigDict, ValidationError

from boxlift.errors import LabelFormatError
from boxlift.storage import read_whole

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

    @classmethod
    def of(cls, source: AnyPath, layout: str) -> SourceEntry:
        """That of a data set where it is now."""
        path = location_of(source)
        return cls(id=hashlib.sha256(path.encode()).hexdigest()[:8], path=path, layout=layout)


class Manifest(BaseModel):
    """How a label set was made.

    version: of the boxlift that labels. prompts, masks: as they were named. detector_digest: SHA-256 of the
    detector's file, where it found the prompts. tracking: how it was tracked from a label set that was made
    so; None for one that is not tracked. fingerprint: covers all that labels depend on but the frames.
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
    def made(cls, sources: tuple[SourceEntry, ...], **made: Any) -> Manifest:
        """One whose fingerprint covers what is `made`: version, prompts, masks, detector_digest, settings."""
        return cls(fingerprint=_fingerprint(made), sources=sources, **made)

    def tracked(self, tracking: dict[str, Any]) -> Manifest:
        """That of the label set that is tracked from this one."""
        fingerprint = _fingerprint({"labels": self.fingerprint, "tracking": tracking})
        return self.model_copy(update={"fingerprint": fingerprint, "tracking": tracking})

    def source_id(self, source: AnyPath) -> str | None:
        """The id of a data set; None where it is none of the sources."""
        path = location_of(source)
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


def location_of(source: AnyPath) -> str:
    """A data set's path as manifests have it."""
    return str(source.absolute())


def _fingerprint(made: dict[str, Any]) -> str:
    canonical = json.dumps(made, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(canonical.encode()).hexdigest()[:16]
