"""Generated drives: the own car drives through a scene whose traffic moves, with exact tracks.

>>> from boxlift.datasets.generated import DriveSettings, generate_drive, write_drive
>>> write_drive(Path("drives"), "0000", generate_drive(3))  # doctest: +SKIP
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from boxlift.camera import Floats
from boxlift.datasets.generated.frames import GeneratedFrame, look
from boxlift.datasets.generated.rig import KITTI_RIG, Rig
from boxlift.datasets.generated.scene import SceneSettings, build_scene
from boxlift.datasets.generated.sensors import cam_to_scene
from boxlift.datasets.generated.traffic import Traffic
from boxlift.datasets.generated.write import calibration_text, write_png
from boxlift.formats import kitti_tracks
from boxlift.formats.kitti_label import KittiObject
from boxlift.formats.kitti_tracks import NO_TRACK, TrackedObject
from boxlift.poses import inverse, pose
from boxlift.sweep import SweepView

# Between two sweeps traffic moves in so many steps.
_STEPS = 5


@dataclass(frozen=True)
class DriveSettings:
    """sweeps, period_s apart; speed_m_s: of the own car; scene: what it drives through."""

    sweeps: int = 40
    period_s: float = 0.1
    speed_m_s: float = 8.0
    scene: SceneSettings = field(default_factory=SceneSettings)


@dataclass(frozen=True)
class GeneratedSweep:
    """One sweep of a drive: its frame (with its view and pose), and the track of each line of the truth."""

    generated: GeneratedFrame
    tracks: tuple[int, ...]

    @property
    def tracked(self) -> list[tuple[int, KittiObject]]:
        """(track, line) of everything that has a box."""
        return [
            (track, line)
            for track, line in zip(self.tracks, self.generated.truth, strict=True)
            if track != NO_TRACK
        ]


def generate_drive(
    seed: int, rig: Rig = KITTI_RIG, settings: DriveSettings | None = None, *, with_images: bool = True
) -> Iterator[GeneratedSweep]:
    """The drive of a seed, sweep by sweep. The world is the scene frame, the ego frame the LiDAR's.

    Raises MissingExtraError where Open3D is not installed.
    """
    settings = settings or DriveSettings()
    traffic = Traffic(build_scene(seed, settings.scene), seed, settings.speed_m_s)
    log = f"{seed:04d}"
    for number in range(settings.sweeps):
        place, heading = traffic.own_place()
        driven = replace(rig, car_at_m=place, car_heading_rad=heading)
        name = f"{log}_{number:06d}"
        generated = look(traffic.scene(), driven, name, [seed, number], with_image=with_images)
        view = SweepView(
            sweep=name,
            camera="image_02",
            ego_SE3_cam=inverse(driven.calibration.cam_SE3_velo),
            log=log,
            timestamp_ns=round(number * settings.period_s * 1e9),
            world_SE3_ego=_world_SE3_cam(driven) @ driven.calibration.cam_SE3_velo,
        )
        others = len(generated.truth) - len(generated.objects)
        tracks = (*generated.objects, *[NO_TRACK] * others)
        yield GeneratedSweep(replace(generated, frame=replace(generated.frame, view=view)), tracks)
        for _ in range(_STEPS):
            traffic.advance(settings.period_s / _STEPS)


def _world_SE3_cam(rig: Rig) -> Floats:
    return pose(rig.cam_axes_of_scene.T, cam_to_scene(np.zeros(3), rig))


def write_drive(root: Path, name: str, sweeps: Iterable[GeneratedSweep]) -> int:
    """Writes a drive in KITTI tracking's layout, without poses, and returns the number of its frames.

    ROOT/training/velodyne/NAME/000000.bin, image_02/NAME/000000.png, calib/NAME.txt, label_02/NAME.txt.
    Raises MissingExtraError without Pillow.
    """
    split = root / "training"
    for part in ("velodyne", "image_02"):
        (split / part / name).mkdir(parents=True, exist_ok=True)
    for part in ("calib", "label_02"):
        (split / part).mkdir(exist_ok=True)
    lines: list[TrackedObject] = []
    number = -1
    for number, sweep in enumerate(sweeps):
        frame = sweep.generated.frame
        stem = f"{number:06d}"
        (split / "velodyne" / name / f"{stem}.bin").write_bytes(frame.points_velo.astype("<f4").tobytes())
        image = frame.image
        if image is None:  # readers ask the first image for its size
            width, height = frame.image_size_px
            image = np.zeros((height, width, 3), dtype=np.uint8)
        write_png(split / "image_02" / name / f"{stem}.png", image)
        (split / "calib" / f"{name}.txt").write_text(calibration_text(sweep.generated.rig), encoding="utf-8")
        lines += [
            TrackedObject(number, track, line)
            for track, line in zip(sweep.tracks, sweep.generated.truth, strict=True)
        ]
    (split / "label_02" / f"{name}.txt").write_text(kitti_tracks.to_text(lines), encoding="utf-8")
    return number + 1
