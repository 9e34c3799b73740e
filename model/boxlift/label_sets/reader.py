"""How the frames of a label set are read again: their details, and what their data set holds."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from boxlift.datasets import FrameSource, open_source
from boxlift.errors import DatasetError
from boxlift.formats.details import FrameDetails
from boxlift.frame import Frame, Prompt
from boxlift.label_sets.files import details_path
from boxlift.label_sets.index import read_details
from boxlift.label_sets.ledger_parts import LEDGER, read_frame_sources
from boxlift.label_sets.manifest import Manifest
from boxlift.storage import is_folder, open_path

if TYPE_CHECKING:
    from boxlift.storage import AnyPath


@dataclass
class LabelSetReader:
    """Frames of a label set from the data sets that it was made of. See boxlift.tracking.DriveReader.

    source: the data set, where it is not at the manifest's path any more. Raises DatasetError, OSError.
    """

    label_set: AnyPath
    manifest: Manifest
    source: AnyPath | None = None
    _opened: dict[str, FrameSource] = field(default_factory=dict)
    _source_of: dict[str, str] | None = None

    def details(self, name: str) -> FrameDetails:
        """What one frame's labels say. Raises LabelFormatError, OSError."""
        return read_details(details_path(self.label_set, name))

    def load(self, name: str, prompts: tuple[Prompt, ...], *, with_image: bool = False) -> Frame:
        """The frame, its image left out unless asked for. Raises InputError."""
        source = self.source_of(name)
        masks = self._masks(source) if prompts else None
        return source.load(name, prompts, masks=masks, with_image=with_image)

    def check(self) -> None:
        """Raises DatasetError where a data set is not where the manifest says."""
        for path in [self._path(entry.path) for entry in self.manifest.sources]:
            self._open(path)

    def source_of(self, name: str) -> FrameSource:
        """The data set of a frame. Raises DatasetError."""
        if len(self.manifest.sources) == 1 or self.source is not None:
            return self._open(self._path(self.manifest.sources[0].path))
        if self._source_of is None:
            self._source_of = read_frame_sources(self.label_set / LEDGER)
        paths = {entry.id: entry.path for entry in self.manifest.sources}
        try:
            return self._open(paths[self._source_of[name]])
        except KeyError:
            problem = f"nothing says which data set frame {name!r} is of."
            raise DatasetError(str(self.label_set), problem, "Give --source.") from None

    def _path(self, recorded: str) -> str:
        return recorded if self.source is None else str(self.source)

    def _open(self, path: str) -> FrameSource:
        if path not in self._opened:
            try:
                self._opened[path] = open_source(open_path(path))
            except DatasetError as error:
                problem = f"the data set of the labels cannot be opened ({error})"
                raise DatasetError(path, problem, "Give --source where it has moved.") from None
        return self._opened[path]

    def _masks(self, source: FrameSource) -> AnyPath | None:
        """Masks that lie inside the data set; the manifest has no path of others."""
        if self.manifest.masks is None:
            return None
        folder = source.root / self.manifest.masks
        return folder if is_folder(folder) else None
