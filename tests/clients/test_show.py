"""`boxlift show` beyond pictures of one frame: recordings, and a run that is watched."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from PIL import Image

from clients.command import Boxlift


def test_a_recording_has_boxes_points_and_image(
    dataset: Path, labelled: Path, boxlift: Boxlift, tmp_path: Path
) -> None:
    from rerun.chunk import RrdReader

    out = tmp_path / "frame.rrd"
    ran = boxlift("show", dataset, "000001", "--pred", labelled, "--rerun", "--out", out)
    assert ran.status == 0, ran.err
    entities = {str(each.entity_path) for each in RrdReader(out).stream()}
    assert {"/ego/labels", "/ego/points", "/ego/image_2"} <= entities


@pytest.mark.parametrize(
    ("options", "remedy"),
    [
        (("000001", "--rerun", "--out", "a.rrd"), "Give --pred LABELS."),
        (("--watch", "--out", "a.png"), "Give --pred LABELS."),
        (("--out", "a.png"), "Name one, or give --watch."),
    ],
)
def test_what_is_missing_is_named(
    dataset: Path, boxlift: Boxlift, options: tuple[str, ...], remedy: str
) -> None:
    ran = boxlift("show", dataset, *options)
    assert (ran.status, remedy in ran.err) == (2, True)


def test_a_recordings_name_ends_in_rrd(
    dataset: Path, labelled: Path, boxlift: Boxlift, tmp_path: Path
) -> None:
    ran = boxlift("show", dataset, "000001", "--pred", labelled, "--rerun", "--out", tmp_path / "a.png")
    assert (ran.status, "ends in .rrd" in ran.err) == (2, True)


def test_a_run_is_watched(dataset: Path, labelled: Path, tmp_path: Path) -> None:
    """Frames come one by one; the picture is always the newest."""
    growing, out = tmp_path / "growing", tmp_path / "newest.png"
    for folder in ("data", "details"):
        (growing / folder).mkdir(parents=True)

    def add(name: str) -> None:
        for folder, suffix in (("details", ".json"), ("data", ".txt")):
            shutil.copyfile(labelled / folder / f"{name}{suffix}", growing / folder / f"{name}{suffix}")

    program = str(Path(sys.executable).with_name("boxlift"))
    command = [program, "show", str(dataset), "--pred", str(growing), "--watch"]
    with subprocess.Popen([*command, "--out", out], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for name in ("000000", "000002"):
            add(name)
            assert process.stdout.readline().strip() == name
            with Image.open(out) as picture:
                assert picture.size[0] >= 960
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0
    assert {path.name for path in tmp_path.iterdir()} == {"growing", "newest.png"}
