"""Frames that were dropped onto the page: kept as a plain data set, with a label set around it.

    ROOT/dropped/frames/{velodyne,calib,image_2}/NAME.*      what was dropped
    ROOT/dropped/{data,details}/NAME.*, manifest.json        its labels

So every command works on them: `boxlift label ROOT/dropped/frames`, `boxlift convert ROOT/dropped`.
"""

from __future__ import annotations

import re
from pathlib import Path, PurePath

import boxlift
from boxlift.errors import InputError
from boxlift.formats.details import FrameDetails
from boxlift.label_sets.files import details_path, write_label_files
from boxlift.label_sets.manifest import MANIFEST, Manifest, SourceEntry
from boxlift.settings import ACCURATE
from boxlift.storage import write_whole
from boxlift_service.bodies.shared_parts import Part, SharedParts

FOLDER = "dropped"
_POINT_SUFFIXES = (".bin", ".npy", ".npz", ".pcd", ".ply")
_NOT_IN_NAMES = re.compile(r"[^A-Za-z0-9._-]+")
_LONGEST_NAME = 100


class DroppedFrame:
    """The files of one dropped frame, and the name that it gets in `folder`.

    The name is that of its points' file; with a number, where another frame has it.
    """

    def __init__(self, folder: Path, parts: SharedParts) -> None:
        self._folder = folder
        points, calib = parts.read("points")[0], parts.read("calib")[0]
        image = parts.read("image")[0] if "image" in parts else None
        given = PurePath(points.filename or "")
        suffix = given.suffix.lower() if given.suffix.lower() in _POINT_SUFFIXES else ".bin"
        self._files = {("velodyne", suffix): points, ("calib", _calib_suffix(calib)): calib}
        if image is not None:
            png = image.data.startswith(b"\x89PNG")
            self._files["image_2", ".png" if png else ".jpg"] = image
        stem = _NOT_IN_NAMES.sub("_", given.stem)[:_LONGEST_NAME].lstrip(".") or "frame"
        self.name = self._free_name(stem)

    def write(self, details: FrameDetails) -> None:
        """Write the frame, then its labels, then the manifest: whoever finds a file finds what it needs."""
        for path, part in self._paths(self.name):
            path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(path, part.data)
        source = SourceEntry.of(self._folder / "frames", "plain folder")
        manifest = Manifest.made(
            (source,),
            version=boxlift.__version__,
            prompts="detector",
            masks=None,
            detector_digest=details.model_digest,
            settings=ACCURATE.model_dump(mode="json"),
        )
        for folder in ("data", "details"):
            (self._folder / folder).mkdir(parents=True, exist_ok=True)
        write_label_files(self._folder, self.name, details)
        write_whole(self._folder / MANIFEST, manifest.text().encode())

    def _paths(self, name: str) -> list[tuple[Path, Part]]:
        frames = self._folder / "frames"
        return [(frames / kind / f"{name}{suffix}", part) for (kind, suffix), part in self._files.items()]

    def _free_name(self, stem: str) -> str:
        for number in range(1, 10_000):
            name = stem if number == 1 else f"{stem}-{number}"
            if not details_path(self._folder, name).exists() or self._holds_this(name):
                return name
        raise InputError("points", f"the name {stem!r} is taken 10,000 times.", "Rename the file.")

    def _holds_this(self, name: str) -> bool:
        return all(path.is_file() and path.read_bytes() == part.data for path, part in self._paths(name))


def _calib_suffix(calib: Part) -> str:
    return ".json" if calib.data.lstrip().startswith(b"{") else ".txt"
