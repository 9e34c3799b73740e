"""A plain folder of frames.

    velodyne/STEM.bin (or .npy .npz .pcd .ply)   points in the LiDAR frame
    calib/STEM.txt    (or .json)                 or one calib.txt / calib.json for all frames
    image_2/STEM.png  (or .jpg .jpeg)            optional where the calibration says image_size

A calibration in JSON may have a distortion: image, masks and 2D boxes are those of the camera, and the frame
that is loaded is rectified. Stems are any names. Where a stem has files of several suffixes, the first in the
order above is taken.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from boxlift.datasets.folder_files import FolderFiles
from boxlift.datasets.plain_answers import NoAnnotations
from boxlift.errors import (
    CalibrationError,
    DatasetError,
    ImageError,
    InputError,
    NoLidarError,
    PointCloudError,
)
from boxlift.formats import calibration, image, point_cloud
from boxlift.formats.calibration import ParsedCalibration
from boxlift.frame import Frame, Prompt
from boxlift.lens import Lens
from boxlift.storage import is_folder

if TYPE_CHECKING:
    from boxlift.storage import AnyPath


class PlainFolder(NoAnnotations):
    """FrameSource for a folder that holds velodyne/ and calib/."""

    layout = "plain folder"

    def __init__(self, root: AnyPath) -> None:
        self.root = root
        self._points = FolderFiles(root / "velodyne", point_cloud.SUFFIXES)
        self._images = FolderFiles(root / "image_2", image.SUFFIXES)
        self._calibrations = FolderFiles(root / "calib", calibration.SUFFIXES)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all frames, sorted: every stem that has points or an image."""
        return stems_of(self._points, self._images)

    def load(
        self,
        name: str,
        prompts: tuple[Prompt, ...] = (),
        *,
        masks: AnyPath | None = None,
        with_image: bool = False,
    ) -> Frame:
        """See FrameSource.load."""
        points = self._read(self._points, name, PointCloudError)
        if points is None:
            if name not in self.names:
                raise DatasetError(
                    str(self.root), f"there is no frame {name!r}.", "See its velodyne/ for names."
                )
            raise NoLidarError(
                str(self.root / "velodyne"),
                f"frame {name!r} has no LiDAR points.",
                f"Add {name} with one of the suffixes {' '.join(point_cloud.SUFFIXES)}, or skip the frame.",
            )
        parsed = self._calibration(name)
        # Read once, for its size and its pixels: in an object store each read is a request.
        picture = self._read(self._images, name, ImageError)
        points_path, points_data = points
        return Frame(
            name=name,
            points_velo=point_cloud.decode_points(points_data, points_path.name, str(points_path)).points,
            calibration=parsed.calibration,
            image_size_px=self._image_size(name, picture, parsed),
            prompts=prompts,
            image=decode_rectified(picture[1], str(picture[0]), parsed.lens)
            if with_image and picture is not None
            else None,
            instance_ids=None if masks is None else read_instance_ids(masks, name, parsed.lens),
            lens=parsed.lens,
        )

    @cached_property
    def _calibration_for_all(self) -> ParsedCalibration | None:
        paths = [self.root / f"calib{suffix}" for suffix in calibration.SUFFIXES]
        return next(
            (calibration.read_calibration(path, with_lens=True) for path in paths if path.is_file()), None
        )

    @cached_property
    def _has_calibrations(self) -> bool:
        return is_folder(self._calibrations.folder)

    def _calibration(self, name: str) -> ParsedCalibration:
        found = self._read(self._calibrations, name, CalibrationError) if self._has_calibrations else None
        if found is not None:
            return calibration.parse_calibration(found[1], str(found[0]), with_lens=True)
        if self._calibration_for_all is not None:
            return self._calibration_for_all
        raise DatasetError(
            str(self.root / "calib"),
            f"frame {name!r} has no calibration.",
            f"Add calib/{name}.txt or calib/{name}.json, or one calib.txt for all frames.",
        )

    def _read(
        self, files: FolderFiles, name: str, error_type: type[InputError]
    ) -> tuple[AnyPath, bytes] | None:
        try:
            return files.read(name)
        except OSError as error:
            raise error_type(
                str(error.filename or files.folder / name),
                f"the file cannot be read ({error.strerror or error}).",
                "Check the path.",
            ) from None

    def _image_size(
        self, name: str, picture: tuple[AnyPath, bytes] | None, parsed: ParsedCalibration
    ) -> tuple[int, int]:
        if picture is None:
            if parsed.image_size_px is None:
                raise DatasetError(
                    str(self.root / "image_2"),
                    f"frame {name!r} has no image, so the image's size is not known.",
                    'Add its image, or a calibration as JSON with "image_size": [width, height].',
                )
            return parsed.image_size_px
        path, encoded = picture
        size = image.image_size(encoded, str(path))
        if parsed.image_size_px not in (None, size):
            raise DatasetError(
                str(path),
                f"the image (width, height) is {size}, its calibration says {parsed.image_size_px}.",
                "Give the calibration of this image.",
            )
        return size


def recognise(root: AnyPath) -> PlainFolder | None:
    """A folder that holds velodyne/ (and calib/)."""
    return PlainFolder(root) if is_folder(root / "velodyne") else None


def stems_of(*kinds: FolderFiles) -> tuple[str, ...]:
    """Every stem that has a file of any of the kinds, sorted; the folders are listed at the same time."""
    with ThreadPoolExecutor(len(kinds)) as threads:
        listed = list(threads.map(lambda files: files.by_stem.keys(), kinds))
    return tuple(sorted(frozenset().union(*listed)))


def decode_rectified(encoded: bytes, field: str, lens: Lens | None) -> NDArray[np.uint8]:
    """An encoded image -> (H, W, 3) RGB of a camera without distortion. Raises ImageError."""
    pixels = image.decode_image(encoded, field)
    return pixels if lens is None else lens.rectified_image(pixels)


def read_instance_ids(folder: AnyPath, name: str, lens: Lens | None) -> NDArray[np.uint16]:
    """The masks of a frame, of the rectified image: folder/NAME.png. Raises DatasetError, PromptError."""
    path = folder / f"{name}.png"
    if not path.is_file():
        raise DatasetError(
            str(path), f"frame {name!r} has no masks there.", "Add them as 16-bit PNG, or leave --masks out."
        )
    instance_ids = image.decode_instance_ids(path, str(path))
    return instance_ids if lens is None else lens.rectified_ids(instance_ids)
