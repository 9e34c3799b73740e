from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from boxlift import Calibration, __version__
from boxlift.formats.calibration import read_calibration, to_kitti_text
from clients.command import Boxlift


def test_label_evaluate_show(boxlift: Boxlift, dataset: Path, tmp_path: Path) -> None:
    frames = tmp_path / "frames.csv"
    frames.write_text("frame,drive\n000000,a\n000002,b\n")
    out = tmp_path / "out"
    before = {path: path.stat().st_mtime_ns for path in dataset.rglob("*")}
    ran = boxlift(
        "label", dataset, "--out", out, "--prompts", "label_2", "--frames", frames, "--masks", "masks"
    )
    assert (ran.status, ran.err) == (0, "")
    assert ran.out.startswith("2 frames: 2 labelled, 0 skipped, 0 failed")
    assert "FITTED" in ran.out
    assert str(out / "data") in ran.out
    assert sorted(path.name for path in (out / "data").iterdir()) == ["000000.txt", "000002.txt"]
    assert {path: path.stat().st_mtime_ns for path in dataset.rglob("*")} == before

    truth = dataset / "training" / "label_2"
    for pred in (out, out / "data"):
        ran = boxlift("evaluate", "--gt", truth, "--pred", pred, "--frames", frames, "--json")
        assert ran.status == 0
        evaluation = json.loads(ran.out)
        assert evaluation["frames"] == 2
        assert {"recall_points", "ap_3d", "aos"} <= set(evaluation["results"]["Car"][0])
    ran = boxlift("evaluate", "--gt", truth, "--pred", out, "--frames", frames)
    assert ran.status == 0
    assert "KITTI average precision in %, 2 frames" in ran.out
    ran = boxlift("evaluate", "--gt", truth, "--pred", out)
    assert ran.status == 2
    assert ran.err.startswith("error: ")
    assert "000001" in ran.err

    pictures = []
    for name, options in {
        "pred": ("--pred", out, "--gt", "label_2"),
        "new": ("--prompts", "label_2", "--preset", "release"),
        "plain": (),
    }.items():
        ran = boxlift("show", dataset, "000000", "--out", tmp_path / f"{name}.png", *options)
        assert (ran.status, ran.err) == (0, "")
        pictures.append(np.array(Image.open(tmp_path / f"{name}.png")))
    assert all(picture.shape[1] == 1242 and picture.shape[0] > 375 for picture in pictures)
    assert not np.array_equal(pictures[0], pictures[1])
    assert not np.array_equal(pictures[0], pictures[2])


def test_failed_frames_are_exit_status_1(
    boxlift: Boxlift, dataset: Path, service_url: str, tmp_path: Path
) -> None:
    root = tmp_path / "dataset"
    shutil.copytree(dataset, root)
    (root / "training" / "velodyne" / "000000.bin").write_bytes(b"")
    (root / "training" / "velodyne" / "000001.bin").unlink()
    http = ("--prompts", "label_2", "--engine", "http", "--url", service_url)
    ran = boxlift("label", root, "--out", tmp_path / "out", *http)
    assert ran.status == 1
    assert ran.out.startswith("3 frames: 1 labelled, 1 skipped, 1 failed")
    assert "failed 000000: " in ran.out
    assert "skipped 000001: " in ran.out
    frames = tmp_path / "frames"
    frames.write_text("000001\n000002\n")
    ran = boxlift("label", root, "--out", tmp_path / "out", "--frames", frames, *http)
    assert ran.status == 0  # skipped is not failed


@pytest.mark.parametrize("engine", ["local", "http"])
def test_frames_of_a_wrong_rig_are_counted_and_shown(
    boxlift: Boxlift, dataset: Path, service_url: str, tmp_path: Path, engine: str
) -> None:
    root = tmp_path / "dataset"
    shutil.copytree(dataset, root)
    path = root / "training" / "calib" / "000001.txt"
    right = read_calibration(path).calibration
    cam_SE3_velo = right.cam_SE3_velo.copy()
    cam_SE3_velo[:3, :3] = cam_SE3_velo[:3, :3].T
    path.write_text(to_kitti_text(Calibration(right.image_P_cam, cam_SE3_velo)))
    where = ("--engine", "http", "--url", service_url) if engine == "http" else ()
    ran = boxlift("label", root, "--out", tmp_path / "out", "--prompts", "label_2", *where)
    assert (ran.status, ran.err) == (0, "")
    assert "1 frame with warnings about the calibration:\n  TILTED " in ran.out
    assert "000001: The ground leans " in ran.out
    written = json.loads((tmp_path / "out" / "details" / "000001.json").read_text())
    assert [warning["name"] for warning in written["warnings"]] == ["TILTED"]


def test_priors_of_ones_own_travel_with_the_job(
    boxlift: Boxlift, dataset: Path, service_url: str, tmp_path: Path
) -> None:
    prompts, priors = tmp_path / "prompts", tmp_path / "priors.toml"
    shutil.copytree(dataset / "training" / "label_2", prompts)
    for path in prompts.iterdir():
        path.write_text(path.read_text().replace("Car ", "Taxi "))
    priors.write_text('[Taxi]\nheight_m = 1.5\nwidth_m = 1.7\nlength_m = 4.5\nsource = "measured"\n')
    ran = boxlift(
        "label", dataset, "--out", tmp_path / "out", "--prompts", prompts, "--priors", priors,
        "--size", "fixed", "--engine", "http", "--url", service_url,
    )  # fmt: skip
    assert (ran.status, ran.err) == (0, "")
    lines = "".join(path.read_text() for path in (tmp_path / "out" / "data").iterdir()).splitlines()
    taxis = [line for line in lines if line.startswith("Taxi ")]
    assert taxis
    assert all(line.split()[8:11] == ["1.50", "1.70", "4.50"] for line in taxis)
    ran = boxlift(
        "show", dataset, "000000", "--out", tmp_path / "a.png", "--prompts", prompts, "--priors", priors
    )
    assert (ran.status, ran.err) == (0, "")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["label", "nowhere", "--prompts", "label_2"], "nowhere: the folder does not exist. Check the path."),
        (["label", "SOURCE", "--prompts", "nowhere"], "nowhere: there is no such folder"),
        (["label", "SOURCE", "--prompts", "label_2", "--preset", "best"], "preset: 'best' is no preset."),
        (["label", "SOURCE", "--prompts", "label_2", "--masks", "no"], "no: there is no such folder"),
        (["label", "SOURCE", "--prompts", "label_2", "--priors", "no"], "no: the file cannot be read"),
        (["label", "SOURCE", "--prompts", "label_2", "--frames", "no"], "frames: 'no' cannot be read"),
        (["label", "SOURCE", "--prompts", "label_2", "--url", "http://x"], "url: 'http://x' is given to the"),
        (
            ["label", "SOURCE", "--prompts", "label_2", "--engine", "http", "--url", "http://127.0.0.1:9"],
            "http://127.0.0.1:9: no boxlift service answers",
        ),
    ],
)
def test_wrong_input_is_one_line_and_exit_status_2(
    boxlift: Boxlift,
    dataset: Path,
    tmp_path: Path,
    arguments: list[str],
    message: str,
) -> None:
    given = [str(dataset) if word == "SOURCE" else word for word in arguments]
    ran = boxlift(*given, "--out", tmp_path / "out")
    assert ran.status == 2
    assert ran.out == ""
    assert ran.err.startswith(f"error: {message}")
    assert ran.err.count("\n") == 1
    assert not list(tmp_path.glob("out/*/*"))


def test_out_that_cannot_be_written(boxlift: Boxlift, dataset: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    ran = boxlift("label", dataset, "--out", tmp_path / "file" / "out", "--prompts", "label_2")
    assert ran.status == 2
    assert ran.err.startswith("error: out: ")
    ran = boxlift("show", dataset, "000000", "--out", tmp_path / "a.txt")
    assert (ran.status, ran.err.startswith("error: out: 'a.txt'")) == (2, True)
    ran = boxlift("show", dataset, "999999", "--out", tmp_path / "a.png")
    assert (ran.status, "there is no frame '999999'" in ran.err) == (2, True)


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_run_that_is_ended_keeps_what_is_finished(
    dataset: Path, tmp_path: Path, how: signal.Signals
) -> None:
    root, out = tmp_path / "dataset", tmp_path / "out"
    shutil.copytree(dataset, root)
    hanging = root / "training" / "velodyne" / "000001.bin"
    hanging.unlink()
    os.mkfifo(hanging)  # whoever reads it waits for ever
    # A shell's background jobs ignore Ctrl-C, and so would what they start: this process does not.
    heed = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    command = f"{heed}; import sys; from boxlift_client.cli import main; main(sys.argv[1:])"
    arguments = ["label", str(root), "--out", str(out), "--prompts", "label_2", "--workers", "1"]
    run = subprocess.Popen([sys.executable, "-c", command, *arguments], stderr=subprocess.PIPE, text=True)
    while True:  # until the worker has come to the frame that hangs
        assert run.poll() is None
        try:
            pipe = os.open(hanging, os.O_WRONLY | os.O_NONBLOCK)
        except OSError:
            time.sleep(0.05)
            continue
        break
    run.send_signal(how)
    _, stderr = run.communicate()  # returns when the worker, which shares stderr, has ended too
    os.close(pipe)  # only now: closed earlier, the frame would end and the next one begin
    assert [path.name for path in (out / "data").iterdir()] == ["000000.txt"]
    status = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGKILL: -signal.SIGKILL}
    assert run.returncode == status[how]
    assert ("Interrupted." in stderr) == (how != signal.SIGKILL)
    # Who could still write its rows did.
    assert (out / "ledger").is_dir() == (how != signal.SIGKILL)


def test_demo(boxlift: Boxlift, tmp_path: Path) -> None:
    ran = boxlift("demo", "--out", tmp_path / "demo", "--frames", 1, "--seed", 5)
    assert (ran.status, ran.err) == (0, "")
    assert "1 frame: 1 labelled" in ran.out
    assert "Car" in ran.out
    assert [path.name for path in (tmp_path / "demo" / "pictures").iterdir()] == ["000000.png"]
    assert (tmp_path / "demo" / "dataset" / "training" / "label_2" / "000000.txt").stat().st_size > 0
    assert len(ran.out.splitlines()) <= 40


def test_serve_says_what_is_wrong(boxlift: Boxlift, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BOXLIFT_MAX_POINTS", "many")
    ran = boxlift("serve", "--port", 0)
    assert ran.status == 2
    assert ran.err.startswith("error: BOXLIFT_MAX_POINTS: ")
    assert boxlift("serve", "--port", 70_000).status == 2
    monkeypatch.delenv("BOXLIFT_MAX_POINTS")
    ran = boxlift("serve", "--port", 0, "--model", "nowhere.onnx")
    assert ran.status == 2
    assert ran.err == (
        "error: BOXLIFT_MODEL: nowhere.onnx: the path does not exist. Give the path of an ONNX model.\n"
    )


def test_help_is_light() -> None:
    command = (
        "import sys; from boxlift_client.cli import app; "
        "heavy = {'torch', 'open3d', 'httpx', 'PIL', 'fastapi', 'boxlift_service'} & set(sys.modules); "
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", command], check=True)
    script = Path(sys.executable).with_name("boxlift")
    if script.exists():
        ran = subprocess.run([script, "--version"], check=True, capture_output=True, text=True)
        assert ran.stdout == f"boxlift {__version__}\n"
        ran = subprocess.run([script, "--help"], check=True, capture_output=True, text=True)
        assert all(command in ran.stdout for command in ("demo", "serve", "label", "evaluate", "show"))
