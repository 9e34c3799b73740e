"""Images with their cameras, no LiDAR asked for.

    one image                                    with a calibration file, or a folder of them by stem
    a folder of images                           likewise
    a folder with image_2/ (training/image_2/)   likewise; by default the calib/ or calib.txt in it

Images are .png, .jpg or .jpeg; calibrations .txt (KITTI) or .json, of which only the camera is read. Stems
are any names. Where a stem has files of several suffixes, the first in the order above is taken.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from boxlift.datasets.folder_files import files_by_stem
from boxlift.datasets.plain_answers import NoAnnotations
from boxlift.errors import DatasetError
from boxlift.formats import calibration, image
from boxlift.formats.calibration import ParsedCalibration, read_calibration

_LAYOUTS = (("training", "image_2"), ("testing", "image_2"), ("image_2",))


@dataclass(frozen=True)
class ImageFolder(NoAnnotations):
    """Images by name, each with a camera.

    root: beside whose parts labels may lie. images: name -> file. calib: a file for all images, a folder with
    one for each, or None where there is none.
    """

    root: Path
    images: dict[str, Path]
    calib: Path | None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all images, sorted."""
        return tuple(sorted(self.images))

    def image_path(self, name: str) -> Path:
        """The file of an image. Raises DatasetError where there is none of that name."""
        if name not in self.images:
            raise DatasetError(str(self.root), f"there is no image {name!r}.", "Check the name.")
        return self.images[name]

    def calibration_path(self, name: str) -> Path:
        """The file that holds the camera of an image. Raises DatasetError where there is none."""
        if self.calib is not None and self.calib.is_file():
            return self.calib
        path = None if self.calib is None else self._calibrations.get(name)
        if path is None:
            raise DatasetError(
                str(self.calib or self.root),
                f"image {name!r} has no calibration.",
                f"Add {name}.txt (KITTI) or {name}.json, or give one file for all images.",
            )
        return path

    def camera(self, name: str) -> ParsedCalibration:
        """The camera of an image. Raises DatasetError or CalibrationError."""
        return read_calibration(self.calibration_path(name), camera_only=True)

    @cached_property
    def _calibrations(self) -> dict[str, Path]:
        return {} if self.calib is None else files_by_stem(self.calib, calibration.SUFFIXES)


def open_images(path: Path, calib: Path | None = None) -> ImageFolder:
    """Images in one of the layouts above.

    Raises DatasetError where there is none, or where `calib` is neither file nor folder.
    """
    if calib is not None and not calib.exists():
        raise DatasetError(str(calib), "the calibration does not exist.", "Give a file, or a folder of them.")
    if path.is_file():
        if path.suffix.lower() not in image.SUFFIXES:
            raise DatasetError(str(path), "the file is no image by its name.", "Give a .png, .jpg or .jpeg.")
        return ImageFolder(path.parent, {path.stem: path}, calib)
    if not path.is_dir():
        raise DatasetError(str(path), "there is no such file or folder.", "Check the path.")
    folder = next((inside for parts in _LAYOUTS if (inside := path.joinpath(*parts)).is_dir()), path)
    root = path if folder == path else folder.parent
    images = files_by_stem(folder, image.SUFFIXES)
    if not images:
        raise DatasetError(
            str(folder),
            "the folder holds no image.",
            f"Give one with files {', '.join(image.SUFFIXES)}, or one that holds image_2/.",
        )
    beside = [root / "calib", *(root / f"calib{suffix}" for suffix in calibration.SUFFIXES)]
    return ImageFolder(root, images, calib or next((each for each in beside if each.exists()), None))
