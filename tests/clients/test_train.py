from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from model.network.generated_data import toml, write_frames

CONFIG = toml(
    model='backbone = "nanodet"\nfreeze_backbone = true\nhidden = 32',
    augmentation="flip = 0.5\nscale = 0.1",
    trainer="epochs = 6\nbatch_size = 1\nlearning_rate = 1e-3\nevaluate_every = 2",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("train")
    write_frames(folder / "data")
    (folder / "small.toml").write_text(CONFIG)
    return folder


def _start(folder: Path, out: str) -> subprocess.Popen[str]:
    program = "from boxlift_client.cli import main; main()"
    command = [sys.executable, "-c", program, "train", "small.toml", "--out", out]
    return subprocess.Popen(
        command,
        cwd=folder,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_killed_training_ends_with_the_same_bytes(folder: Path) -> None:
    whole = _start(folder, "whole")
    out, errors = whole.communicate(timeout=300)
    assert whole.returncode == 0, errors
    assert "Epoch 6" in out
    assert errors.count("Epoch ") == 6

    killed, metrics = _start(folder, "killed"), folder / "killed" / "metrics.jsonl"
    until = time.monotonic() + 300
    while not metrics.exists() or metrics.read_text().count("\n") < 2:
        assert killed.poll() is None, killed.communicate()
        assert time.monotonic() < until
        time.sleep(0.005)
    killed.send_signal(signal.SIGKILL)
    killed.communicate()
    assert metrics.read_text().count("\n") < 6
    resumed = _start(folder, "killed")
    _, errors = resumed.communicate(timeout=300)
    assert resumed.returncode == 0, errors
    assert errors.count("Epoch ") < 6
    assert metrics.read_bytes() == (folder / "whole" / "metrics.jsonl").read_bytes()
    for name in ("000000.txt", "000001.txt"):
        written = [folder / run / "predictions" / "data" / name for run in ("whole", "killed")]
        assert written[0].read_bytes() == written[1].read_bytes()


def test_folder_without_a_run_is_not_exported(folder: Path) -> None:
    program = "from boxlift_client.cli import main; main()"
    command = [sys.executable, "-c", program, "export", "data", "--out", "model.onnx"]
    ran = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300, check=False)
    assert ran.returncode == 2
    assert "holds no run" in ran.stderr


def test_other_settings_in_the_same_folder_are_refused(folder: Path) -> None:
    (folder / "small.toml").write_text(CONFIG.replace("flip = 0.5", "flip = 0.4"))
    process = _start(folder, "whole")
    _, errors = process.communicate(timeout=300)
    (folder / "small.toml").write_text(CONFIG)
    assert process.returncode == 2
    assert "other settings" in errors
