"""Files of a folder by stem: listed where all are asked for, read straight where one is.

A worker of a run over a million frames reads the few files of its frames: to list the folder first would
take a bucket minutes, in every worker.
"""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

from boxlift.storage import is_folder, names_in, read_whole

if TYPE_CHECKING:
    from boxlift.storage import AnyPath


@overload
def files_by_stem(folder: Path, suffixes: tuple[str, ...]) -> dict[str, Path]: ...
@overload
def files_by_stem(folder: AnyPath, suffixes: tuple[str, ...]) -> dict[str, AnyPath]: ...
def files_by_stem(folder: Any, suffixes: tuple[str, ...]) -> Any:
    """Files with one of the suffixes by stem; the earlier suffix wins. Hidden files are none."""
    if not is_folder(folder):
        return {}
    rank = {suffix: number for number, suffix in enumerate(suffixes)}
    kept = []
    for name in names_in(folder):
        stem, _, end = name.rpartition(".")
        if stem and name[0] != "." and f".{end.lower()}" in rank:
            kept.append((rank[f".{end.lower()}"], name, stem))
    found: dict[str, Any] = {}
    for _, name, stem in sorted(kept):
        found.setdefault(stem, folder / name)
    return found


class FolderFiles:
    """Files of one kind in a folder, which may not be there."""

    def __init__(self, folder: AnyPath, suffixes: tuple[str, ...]) -> None:
        self.folder = folder
        self._suffixes = suffixes

    @cached_property
    def by_stem(self) -> dict[str, AnyPath]:
        """All of them: see files_by_stem."""
        return files_by_stem(self.folder, self._suffixes)

    def read(self, stem: str) -> tuple[AnyPath, bytes] | None:
        """The file of a stem, the earlier suffix first, and its bytes; None where there is none.

        Suffixes in capitals are found by listing. Raises OSError where a file is there and cannot be read.
        """
        if not stem or stem[0] == "." or "/" in stem or "\\" in stem:
            return None
        for suffix in self._suffixes:
            path = self.folder / f"{stem}{suffix}"
            try:
                return path, read_whole(path)
            except (FileNotFoundError, NotADirectoryError):
                continue
        listed = self.by_stem.get(stem)
        try:
            return None if listed is None else (listed, read_whole(listed))
        except FileNotFoundError:  # listed, and gone since
            return None
