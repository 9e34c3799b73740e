"""Generated frames as files in KITTI object layout.

ROOT/training/velodyne/NAME.bin    float32 x, y, z, intensity
ROOT/training/image_2/NAME.png
ROOT/training/calib/NAME.txt       P0 to P3, R0_rect, Tr_velo_to_cam, Tr_imu_to_velo
ROOT/training/label_2/NAME.txt
ROOT/training/masks/NAME.png       16 bit: prompt index + 1, 0 is no object
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from boxlift.camera import Floats
from boxlift.datasets.generated.frames import GeneratedFrame
from boxlift.datasets.generated.rig import Rig
from boxlift.errors import MissingExtraError
from boxlift.formats import kitti_label

_FOLDERS = ("velodyne", "image_2", "calib", "label_2", "masks")

# KITTI's grey cameras sit 6 cm left and its second pair 54 cm right (Geiger et al., IJRR 2013).
_CAMERA_X_M = {"P0": 0.0, "P1": 0.537, "P3": 0.471}


def write_dataset(root: Path, frames: Iterable[GeneratedFrame]) -> list[str]:
    """Writes all frames and returns their names: 000000, 000001, ... in the order given."""
    names = []
    for index, generated in enumerate(frames):
        names.append(f"{index:06d}")
        write_frame(root, names[-1], generated)
    return names


def write_frame(root: Path, name: str, generated: GeneratedFrame) -> None:
    """Writes one frame under a name of any kind. Raises MissingExtraError without Pillow."""
    paths = {folder: root / "training" / folder for folder in _FOLDERS}
    for path in paths.values():
        path.mkdir(parents=True, exist_ok=True)
    frame = generated.frame
    (paths["velodyne"] / f"{name}.bin").write_bytes(frame.points_velo.astype("<f4").tobytes())
    (paths["calib"] / f"{name}.txt").write_text(calibration_text(generated.rig), encoding="utf-8")
    (paths["label_2"] / f"{name}.txt").write_text(kitti_label.to_text(generated.truth), encoding="utf-8")
    if frame.image is not None:
        write_png(paths["image_2"] / f"{name}.png", frame.image)
    if frame.instance_ids is not None:
        write_png(paths["masks"] / f"{name}.png", frame.instance_ids.astype(np.uint16))


def calibration_text(rig: Rig) -> str:
    """A rig as the text of a KITTI calibration file. P2 is the camera; the others stand beside it."""
    rows: dict[str, Floats] = {}
    for key in ("P0", "P1", "P2", "P3"):
        rows[key] = rig.projection.copy()
        if key in _CAMERA_X_M:
            rows[key][:, 3] = (-rig.focal_px * _CAMERA_X_M[key], 0, 0)
    rows["R0_rect"] = rig.rectification
    rows["Tr_velo_to_cam"] = rig.unrectified_from_velo
    rows["Tr_imu_to_velo"] = np.column_stack([np.eye(3), [-0.81, 0.32, -0.80]])
    return "".join(f"{key}: {' '.join(f'{n:.12e}' for n in row.ravel())}\n" for key, row in rows.items())


def write_png(path: Path, pixels: NDArray[np.unsignedinteger]) -> None:
    """Raises MissingExtraError without Pillow."""
    try:
        from PIL import Image
    except ModuleNotFoundError:
        raise MissingExtraError("pillow", "label") from None
    Image.fromarray(pixels).save(path)
