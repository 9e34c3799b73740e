"""The given frames of raw drives as a data set of sequences: KITTI raw's layout, made of links.

    python benchmarks/kitti_drives.py OUT [FOLDER]

FOLDER (by default ../shared/kitti) holds object/ and weak/ (frames), and sequences/DRIVE/{frames.csv, oxts,
label_02.txt} with calib_imu_to_velo.txt beside them. OUT is what `boxlift label` opens; OUT/label_02 has a
file of labels per frame, for --prompts and as truth. No point and no pixel is copied. Frames keep their raw
numbers, which tell the time: the LiDAR turns ten times a second.
"""

from __future__ import annotations

import csv
import sys
from datetime import datetime, timedelta
from pathlib import Path

from boxlift.formats import kitti_label
from boxlift.formats.kitti_tracks import TrackedObject, read_tracks

SHARED = Path("../shared/kitti")
LABELS = "label_02"
_DAY = "2011_09_26"
_START, _PERIOD = datetime(2011, 9, 26, 13), timedelta(seconds=0.1)


def lay_out(out: Path, folder: Path = SHARED) -> Path:
    """Link every drive of `folder` into `out`; the data set's folder."""
    day = out / _DAY
    (out / LABELS).mkdir(parents=True, exist_ok=True)
    day.mkdir(exist_ok=True)
    (day / "calib_imu_to_velo.txt").write_bytes((folder / "sequences/calib_imu_to_velo.txt").read_bytes())
    for drive in drives_of(folder):
        _lay_out_drive(day, drive, folder)
    return out


def drives_of(folder: Path = SHARED) -> list[Path]:
    """The folders of all drives."""
    return sorted(path for path in (folder / "sequences").iterdir() if path.is_dir())


def log_of(drive: Path) -> str:
    """What frames of a drive begin with."""
    return f"{_DAY}_drive_{drive.name}"


def truths_of(drive: Path) -> dict[str, list[TrackedObject]]:
    """The truth by name of the frame, for every frame that is given."""
    tracks = read_tracks(drive / "label_02.txt")
    with (drive / "frames.csv").open(newline="") as lines:
        numbers = [int(row["raw_frame"]) for row in csv.DictReader(lines)]
    return {
        f"{log_of(drive)}_{number:010d}": [each for each in tracks.get(number, []) if each.line.has_box3d]
        for number in numbers
    }


def _lay_out_drive(day: Path, drive: Path, folder: Path) -> None:
    sync = day / f"{log_of(drive)}_sync"
    for part in ("image_02", "velodyne_points", "oxts"):
        (sync / part / "data").mkdir(parents=True, exist_ok=True)
    last = 0
    with (drive / "frames.csv").open(newline="") as lines:
        for row in csv.DictReader(lines):
            last, files = int(row["raw_frame"]), row["files"]
            (points,) = folder.glob(files.replace("*", "velodyne") + ".*")
            (picture,) = folder.glob(files.replace("*", "image_2") + ".*")
            (calibration,) = folder.glob(files.replace("*", "calib") + ".*")
            stem = f"{last:010d}"
            _link(sync / "velodyne_points" / "data" / f"{stem}.bin", points)
            _link(sync / "image_02" / "data" / f"{stem}{picture.suffix}", picture)
            _link(sync / "oxts" / "data" / f"{stem}.txt", drive / "oxts" / f"{stem}.txt")
            _write_calibration(day, calibration)
    times = (f"{_START + number * _PERIOD:%Y-%m-%d %H:%M:%S.%f}000" for number in range(last + 1))
    (sync / "velodyne_points" / "timestamps.txt").write_text("\n".join(times) + "\n")
    for name, objects in truths_of(drive).items():
        text = kitti_label.to_text(each.line for each in objects)
        (day.parent / LABELS / f"{name}.txt").write_text(text)


def _write_calibration(day: Path, calibration: Path) -> None:
    """The object benchmark's calibration in the words of the raw data; it is the same all day."""
    of = {key: words.split() for key, _, words in map(_parted, calibration.read_text().splitlines())}
    camera = {"S_rect_02": ["1242", "375"], "R_rect_00": of["R0_rect"], "P_rect_02": of["P2"]}
    numbers = of["Tr_velo_to_cam"]
    rotation = [number for place, number in enumerate(numbers) if place % 4 < 3]
    velo = {"R": rotation, "T": numbers[3::4]}
    for name, lines in (("calib_cam_to_cam.txt", camera), ("calib_velo_to_cam.txt", velo)):
        (day / name).write_text("".join(f"{key}: {' '.join(words)}\n" for key, words in lines.items()))


def _parted(line: str) -> tuple[str, str, str]:
    return line.partition(":")


def _link(at: Path, target: Path) -> None:
    at.unlink(missing_ok=True)
    at.symlink_to(target.resolve())


if __name__ == "__main__":
    print(lay_out(Path(sys.argv[1]), *map(Path, sys.argv[2:])))
