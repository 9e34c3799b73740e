"""How often the rig check is silent on right calibrations and speaks on wrong ones.

    python benchmarks/rig_check.py [FOLDER ...] [--generated 12]

FOLDERs are datasets (by default those of ../shared/kitti that exist); prompts are the 2D boxes of label_2
where it is there, else none. Beside them stand generated frames of several rigs, and of some a copy cropped
to the camera's view, one without prompts, and one whose camera looks to the side or back. One line per set:
false alarms, then for each wrong calibration the share of frames that were noticed, in per cent.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from boxlift import Calibration, Frame, InputError
from boxlift.camera import Floats
from boxlift.datasets import load_prompts, open_source
from boxlift.datasets.generated import FAR_APART_RIG, KITTI_RIG, ROOF_32_RIG, Rig, generate
from boxlift.errors import CalibrationError
from boxlift.priors import SIZE_PRIORS
from boxlift.rig_check import check_rig

_SHARED = Path(__file__).resolve().parents[2] / "shared" / "kitti"
_CROP_MARGIN_PX = 40

RIGS = (
    KITTI_RIG,
    ROOF_32_RIG,
    FAR_APART_RIG,
    replace(ROOF_32_RIG, name="roof at 2.5 m", camera_height_m=2.5, lidar_in_cam_m=(0.3, -0.4, -1.0)),
    replace(ROOF_32_RIG, name="view of 30 deg", focal_px=800 / np.tan(np.deg2rad(15))),
    replace(
        KITTI_RIG,
        name="view of 120 deg",
        image_size_px=(1280, 720),
        focal_px=640 / np.tan(np.deg2rad(60)),
        principal_px=(640.0, 360.0),
        projection_offset=(0.0, 0.0, 0.0),
    ),
    replace(KITTI_RIG, name="lidar turned 90", lidar_turn_deg=(0.4, -0.5, 90.0)),
    replace(KITTI_RIG, name="lidar turned 180", lidar_turn_deg=(0.4, -0.5, 180.0)),
)


def rotation(axis: int, angle_rad: float) -> Floats:
    """(3, 3) about x (0), y (1) or z (2)."""
    one, other = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[[one, other], [one, other]] = np.cos(angle_rad)
    matrix[other, one] = np.sin(angle_rad)
    matrix[one, other] = -matrix[other, one]
    return matrix


# The LiDAR's axes as the camera's, as two quarter turns.
QUARTER_TURNS = rotation(0, np.pi / 2) @ rotation(2, np.pi / 2)


def with_rotation(frame: Frame, turned: Floats) -> Frame:
    """The frame with another rotation from LiDAR to camera."""
    cam_SE3_velo = frame.calibration.cam_SE3_velo.copy()
    cam_SE3_velo[:3, :3] = turned
    return replace(frame, calibration=Calibration(frame.calibration.image_P_cam, cam_SE3_velo))


def with_transform(frame: Frame, cam_SE3_velo: Floats) -> Frame:
    """The frame with another transform from LiDAR to camera."""
    return replace(frame, calibration=Calibration(frame.calibration.image_P_cam, cam_SE3_velo))


def rotation_of(frame: Frame) -> Floats:
    """(3, 3) LiDAR to camera."""
    return frame.calibration.cam_SE3_velo[:3, :3]


def small_angles_rad(frame: Frame) -> tuple[float, float, float]:
    """What is left of the rotation without the quarter turns, about x, y, z; z first when applied."""
    rest = QUARTER_TURNS.T @ rotation_of(frame)
    return (
        float(np.arctan2(rest[2, 1], rest[2, 2])),
        float(-np.arcsin(np.clip(rest[2, 0], -1, 1))),
        float(np.arctan2(rest[1, 0], rest[0, 0])),
    )


def small_angles_in_degrees(frame: Frame) -> Frame:
    """The mounting's small angles, written in degrees and read as radians."""
    x, y, z = (float(np.rad2deg(angle)) for angle in small_angles_rad(frame))
    return with_rotation(frame, QUARTER_TURNS @ rotation(2, z) @ rotation(1, y) @ rotation(0, x))


def quarter_turns_by(angle_rad: float) -> Callable[[Frame], Frame]:
    """The two quarter turns by another angle, the small angles as they are."""
    turns = rotation(0, angle_rad) @ rotation(2, angle_rad)
    return lambda frame: with_rotation(frame, turns @ QUARTER_TURNS.T @ rotation_of(frame))


def turned_about_vertical(degrees: float) -> Callable[[Frame], Frame]:
    """Another camera's rotation: it looks to the side or back."""
    turn = rotation(1, np.deg2rad(degrees))
    return lambda frame: with_rotation(frame, turn @ rotation_of(frame))


def resized(factor: float) -> Callable[[Frame], Frame]:
    """Image and prompts of another size, the projection as it was."""

    def resize(frame: Frame) -> Frame:
        width, height = frame.image_size_px
        boxes = [(factor * np.array(prompt.box_px)).tolist() for prompt in frame.prompts]
        prompts = tuple(
            replace(prompt, box_px=(x1, y1, x2, y2))
            for prompt, (x1, y1, x2, y2) in zip(frame.prompts, boxes, strict=True)
        )
        size_px = (round(width * factor), round(height * factor))
        return replace(frame, image_size_px=size_px, prompts=prompts, image=None, instance_ids=None)

    return resize


def in_millimetres(frame: Frame) -> Frame:
    """The translation in millimetres."""
    cam_SE3_velo = frame.calibration.cam_SE3_velo.copy()
    cam_SE3_velo[:3, 3] *= 1000
    return with_transform(frame, cam_SE3_velo)


WRONG: dict[str, Callable[[Frame], Frame]] = {
    "transposed": lambda frame: with_rotation(frame, rotation_of(frame).T),
    "inverted": lambda frame: with_transform(
        frame, np.linalg.inv(frame.calibration.cam_SE3_velo).astype(np.float64)
    ),
    "axes": lambda frame: with_rotation(frame, QUARTER_TURNS.T @ rotation_of(frame)),
    "upside": lambda frame: with_rotation(frame, rotation(2, np.pi) @ rotation_of(frame)),
    "rad>deg": quarter_turns_by(np.deg2rad(np.pi / 2)),
    "deg>rad": quarter_turns_by(90.0),
    "small>rad": small_angles_in_degrees,
    "millimetres": in_millimetres,
    "image/2": resized(0.5),
    "image*2": resized(2.0),
    "turn 90": turned_about_vertical(90),
    "turn -90": turned_about_vertical(-90),
    "turn 180": turned_about_vertical(180),
}


def cropped(frame: Frame) -> Frame:
    """Only the points in the camera's view and a margin around it."""
    pixels, depth_m = frame.calibration.project(frame.calibration.velo_to_cam(frame.points_velo))
    low, high = -_CROP_MARGIN_PX, np.array(frame.image_size_px) + _CROP_MARGIN_PX
    seen = (depth_m > 0) & (pixels >= low).all(axis=1) & (pixels < high).all(axis=1)
    return replace(frame, points_velo=frame.points_velo[seen])


def noticed(frame: Frame, change: Callable[[Frame], Frame]) -> bool:
    """Whether a changed frame raises a warning, or is refused as no calibration at all."""
    try:
        return bool(check_rig(change(frame), SIZE_PRIORS))
    except CalibrationError:
        return True


def frames_on_disk(folder: Path) -> Iterator[Frame]:
    """Frames with LiDAR, and their prompts where there are labels."""
    source = open_source(folder)
    for name in source.names:
        try:
            prompts = load_prompts("label_2", source, name) if (source.root / "label_2").is_dir() else ()
            yield source.load(name, prompts)
        except InputError as error:
            print(f"left out: {error}")


def sets_of(title: str, frames: Sequence[Frame]) -> Iterator[tuple[str, Sequence[Frame]]]:
    """The frames and, of whole sweeps, what else is a right rig and can be made of them."""
    yield title, frames
    if not any(frame.prompts for frame in frames):
        return
    yield f"{title}, cropped", [cropped(frame) for frame in frames]
    bare = [replace(frame, prompts=()) for frame in frames]
    yield f"{title}, no prompts", bare
    for degrees in (90, 180):
        yield f"{title}, looks {degrees}", [turned_about_vertical(degrees)(frame) for frame in bare]


def generated(rig: Rig, count: int) -> list[Frame]:
    """Frames without image and masks, which are not needed here."""
    frames = (generate(seed, rig).frame for seed in range(100, 100 + count))
    return [replace(frame, image=None, instance_ids=None) for frame in frames]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="*")
    parser.add_argument("--generated", type=int, default=12, help="generated frames per rig")
    arguments = parser.parse_args()
    folders = arguments.folders or [path for path in (_SHARED / "object", _SHARED / "weak") if path.is_dir()]

    print(f"{'':28} frames  false  " + " ".join(f"{name:>11}" for name in WRONG))
    seconds: list[float] = []

    def show(title: str, frames: Sequence[Frame]) -> None:
        alarms = []
        for frame in frames:
            start = time.perf_counter()
            alarms.append(bool(check_rig(frame, SIZE_PRIORS)))
            seconds.append(time.perf_counter() - start)
        rates = [np.mean([noticed(frame, change) for frame in frames]) for change in WRONG.values()]
        cells = " ".join(f"{100 * rate:11.0f}" for rate in rates)
        print(f"{title:28} {len(frames):6d} {sum(alarms):6d}  {cells}", flush=True)

    for folder in folders:
        for title, frames in sets_of(folder.name, list(frames_on_disk(folder))):
            show(title, frames)
    for rig in RIGS if arguments.generated else ():
        for title, frames in list(sets_of(rig.name, generated(rig, arguments.generated)))[:3]:
            show(title, frames)
    print(f"median {1000 * np.median(seconds):.1f} ms, worst {1000 * max(seconds):.1f} ms a frame")


if __name__ == "__main__":
    main()
