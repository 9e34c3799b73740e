from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

from boxlift.errors import OptionsError
from boxlift.network.checkpoint import CHECKPOINT_NAME, Curve
from boxlift.network.config import MachineSettings, TrainerSettings
from boxlift.network.curve import read_metrics
from boxlift.network.trainer import learning_rate, train
from model.network.small_training import SmallTask, settings

EPOCHS = 12


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("uninterrupted")
    train(SmallTask(), settings(EPOCHS), folder, "small")
    return folder


def test_loss_falls_and_every_epoch_is_written(uninterrupted: Path) -> None:
    curve = read_metrics(uninterrupted)
    assert [row["epoch"] for row in curve] == list(range(1, EPOCHS + 1))
    assert curve[-1]["loss"] < curve[0]["loss"] / 2
    assert set(curve[0]) == {"epoch", "learning_rate", "loss", "loss/square", "loss/absolute", "at_one"}
    assert list((uninterrupted / "tensorboard").glob("events.*"))


def test_killed_run_goes_on_to_the_same_bytes(uninterrupted: Path, tmp_path: Path) -> None:
    program = Path(__file__).with_name("small_training.py")
    metrics = tmp_path / "metrics.jsonl"
    command = [sys.executable, str(program), str(tmp_path), str(EPOCHS), "0.02"]
    for lived in (2, 5):  # killed twice, in the middle of an epoch
        process = subprocess.Popen(command, env={**os.environ, "OMP_NUM_THREADS": "1"})
        until = time.monotonic() + 60
        while not metrics.exists() or metrics.read_text().count("\n") < lived:
            assert process.poll() is None
            assert time.monotonic() < until
            time.sleep(0.005)
        process.send_signal(signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL
        assert metrics.read_text().count("\n") < EPOCHS
    _, curve = train(SmallTask(), settings(EPOCHS), tmp_path, "small")
    assert metrics.read_bytes() == (uninterrupted / "metrics.jsonl").read_bytes()
    assert len(curve) == EPOCHS


def test_finished_run_is_not_trained_again(uninterrupted: Path) -> None:
    class Nothing:
        def on_step(self, epoch: int, step: int, loss: float) -> None:
            raise AssertionError((epoch, step, loss))

        def on_epoch(self, curve: Curve) -> None:
            raise AssertionError(curve)

    model, _ = train(SmallTask(), settings(EPOCHS), uninterrupted, "small", Nothing())
    assert SmallTask().evaluate(model) == {"at_one": read_metrics(uninterrupted)[-1]["at_one"]}


def test_kill_between_checkpoint_and_metrics_counts_the_epoch_once(
    uninterrupted: Path, tmp_path: Path
) -> None:
    (tmp_path / CHECKPOINT_NAME).write_bytes((uninterrupted / CHECKPOINT_NAME).read_bytes())
    lines = (uninterrupted / "metrics.jsonl").read_text().splitlines(keepends=True)
    (tmp_path / "metrics.jsonl").write_text("".join(lines[:-1]))
    train(SmallTask(), settings(EPOCHS), tmp_path, "small")
    assert (tmp_path / "metrics.jsonl").read_text() == "".join(lines)


def test_folder_of_another_run_is_refused(uninterrupted: Path) -> None:
    with pytest.raises(OptionsError, match="other settings"):
        train(SmallTask(), settings(EPOCHS), uninterrupted, "another")


def test_damaged_checkpoint_is_named(tmp_path: Path) -> None:
    (tmp_path / CHECKPOINT_NAME).write_bytes(b"not a checkpoint")
    with pytest.raises(OptionsError, match=CHECKPOINT_NAME):
        train(SmallTask(), settings(1), tmp_path, "small")


def test_loss_that_is_no_number_ends_the_run(tmp_path: Path) -> None:
    class Diverges(SmallTask):
        def loss(self, model: nn.Module, batch: dict[str, Tensor]) -> dict[str, Tensor]:
            return {"square": model(batch["x"]).mean() * torch.inf}

    with pytest.raises(OptionsError, match="step 1 of epoch 1"):
        train(Diverges(), settings(1), tmp_path, "small")


def test_learning_rate_rises_then_falls() -> None:
    rates = [learning_rate(settings(4), epoch) for epoch in range(4)]
    assert rates == pytest.approx([0.005, 0.01, 0.0075, 0.0025])
    assert learning_rate(TrainerSettings(), 49) == 1e-4


def test_missing_gpu_is_named(tmp_path: Path) -> None:
    if torch.cuda.is_available():
        pytest.skip("there is a GPU")
    on_gpu = TrainerSettings(machine=MachineSettings(accelerator="gpu"))
    with pytest.raises(OptionsError, match="no GPU"):
        train(SmallTask(), on_gpu, tmp_path, "small")


def test_mixed_precision_by_fabric(tmp_path: Path) -> None:
    pytest.importorskip("lightning_fabric")
    mixed = MachineSettings(accelerator="cpu", precision="bf16-mixed")
    whole = settings(3).model_copy(update={"machine": mixed})
    _, curve = train(SmallTask(), whole, tmp_path / "whole", "small")
    assert len(curve) == 3
    assert curve[-1]["loss"] < curve[0]["loss"]
