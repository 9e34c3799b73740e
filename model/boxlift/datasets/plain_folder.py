"""A plain folder of frames.

    velodyne/STEM.bin (or .npy .npz .pcd .ply)   points in the LiDAR frame
    calib/STEM.txt    (or .json)                 or one calib.txt / calib.json for all frames
    image_2/STEM.png  (or .jpg .jpeg)            optional where the calibration says image_size

A calibration in JSON may have a distortion: image, masks and 2D boxes are those of the camera, and the frame
that is loaded is rectified. Stems are any names. Where a stem has files of several suffixes, the first in the
order above is taken.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import NDArray

from boxlift.datasets.plain_answers import NoAnnotations
from boxlift.errors import DatasetError, NoLidarError
from boxlift.formats import calibration, image, point_cloud
from boxlift.formats.calibration import ParsedCalibration
from boxlift.frame import Frame, Prompt
from boxlift.lens import Lens

if TYPE_CHECKING:
    from pathlib import Path

    from boxlift.storage import AnyPath


class PlainFolder(NoAnnotations):
    """FrameSource for a folder that holds velodyne/ and calib/."""

    layout = "plain folder"

    def __init__(self, root: AnyPath) -> None:
        self.root = root

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all frames, sorted: every stem that has points or an image."""
        return tuple(sorted(self._points.keys() | self._images.keys()))

    def load(
        self,
        name: str,
        prompts: tuple[Prompt, ...] = (),
        *,
        masks: AnyPath | None = None,
        with_image: bool = False,
    ) -> Frame:
        """See FrameSource.load."""
        if name not in self.names:
            raise DatasetError(str(self.root), f"there is no frame {name!r}.", "See its velodyne/ for names.")
        if name not in self._points:
            raise NoLidarError(
                str(self.root / "velodyne"),
                f"frame {name!r} has no LiDAR points.",
                f"Add {name} with one of the suffixes {' '.join(point_cloud.SUFFIXES)}, or skip the frame.",
            )
        parsed = self._calibration(name)
        image_path = self._images.get(name)
        # Read once, for its size and its pixels: in an object store each read is a request.
        encoded = None if image_path is None else image.read_image(image_path)
        return Frame(
            name=name,
            points_velo=point_cloud.read_points(self._points[name]).points,
            calibration=parsed.calibration,
            image_size_px=self._image_size(name, encoded, parsed),
            prompts=prompts,
            image=decode_rectified(encoded, str(image_path), parsed.lens) if with_image and encoded else None,
            instance_ids=None if masks is None else read_instance_ids(masks, name, parsed.lens),
            lens=parsed.lens,
        )

    @cached_property
    def _points(self) -> dict[str, AnyPath]:
        return files_by_stem(self.root / "velodyne", point_cloud.SUFFIXES)

    @cached_property
    def _images(self) -> dict[str, AnyPath]:
        return files_by_stem(self.root / "image_2", image.SUFFIXES)

    @cached_property
    def _calibrations(self) -> dict[str, AnyPath]:
        return files_by_stem(self.root / "calib", calibration.SUFFIXES)

    @cached_property
    def _calibration_for_all(self) -> ParsedCalibration | None:
        paths = [self.root / f"calib{suffix}" for suffix in calibration.SUFFIXES]
        return next(
            (calibration.read_calibration(path, with_lens=True) for path in paths if path.is_file()), None
        )

    def _calibration(self, name: str) -> ParsedCalibration:
        if name in self._calibrations:
            return calibration.read_calibration(self._calibrations[name], with_lens=True)
        if self._calibration_for_all is not None:
            return self._calibration_for_all
        raise DatasetError(
            str(self.root / "calib"),
            f"frame {name!r} has no calibration.",
            f"Add calib/{name}.txt or calib/{name}.json, or one calib.txt for all frames.",
        )

    def _image_size(self, name: str, encoded: bytes | None, parsed: ParsedCalibration) -> tuple[int, int]:
        if encoded is None:
            if parsed.image_size_px is None:
                raise DatasetError(
                    str(self.root / "image_2"),
                    f"frame {name!r} has no image, so the image's size is not known.",
                    'Add its image, or a calibration as JSON with "image_size": [width, height].',
                )
            return parsed.image_size_px
        path = str(self._images[name])
        size = image.image_size(encoded, path)
        if parsed.image_size_px not in (None, size):
            raise DatasetError(
                path,
                f"the image (width, height) is {size}, its calibration says {parsed.image_size_px}.",
                "Give the calibration of this image.",
            )
        return size


def recognise(root: AnyPath) -> PlainFolder | None:
    """A folder that holds velodyne/ (and calib/)."""
    return PlainFolder(root) if (root / "velodyne").is_dir() else None


@overload
def files_by_stem(folder: Path, suffixes: tuple[str, ...]) -> dict[str, Path]: ...
@overload
def files_by_stem(folder: AnyPath, suffixes: tuple[str, ...]) -> dict[str, AnyPath]: ...
def files_by_stem(folder: Any, suffixes: tuple[str, ...]) -> Any:
    """Files with one of the suffixes by stem; the earlier suffix wins. Hidden files are none."""
    if not folder.is_dir():
        return {}
    found: dict[str, Any] = {}
    paths = [path for path in folder.iterdir() if path.suffix.lower() in suffixes and path.name[0] != "."]
    for path in sorted(paths, key=lambda path: (suffixes.index(path.suffix.lower()), path.name)):
        found.setdefault(path.stem, path)
    return found


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
