from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch

from boxlift import Calibration, FrameLabels, Prompt, Result
from boxlift.errors import OptionsError
from boxlift.formats import kitti_label
from boxlift.monocular import Monocular
from boxlift.network.checkpoint import read_checkpoint
from boxlift.network.config import LifterModelSettings
from boxlift.network.detections import CLASSES
from boxlift.network.lifter import Lifter
from boxlift.network.lifter_task import FrozenTrunk, LifterTask, build_lifter, lift_frame
from boxlift.network.monocular_export import read_lifter
from boxlift.network.tasks import read_config
from boxlift.network.training_frames import TrainingFrame, load_judged
from boxlift_client.cli import main
from model.network.generated_data import toml
from model.network.lifter_data import write_frames

EPOCHS = 8
CONFIG = 'task = "lifter"\nshare = 1.0\n' + toml(
    rows="views = 3\nshifts = 1",
    model="blind_voices = 1\nseeing_voices = 1\nchannels = 4\nwidth = 16",
    augmentation="flip = 0.5\nscale = 0.1",
    trainer=f"epochs = {EPOCHS}\nbatch_size = 32\nlearning_rate = 3e-3\nevaluate_every = 0",
)
ABOUT = ("--training-data", "three generated frames", "--licence", "none")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A head, trained and exported by the command line on generated frames and their pseudo labels."""
    torch.set_num_threads(1)
    folder = tmp_path_factory.mktemp("lifter")
    write_frames(folder / "data")
    (folder / "run.toml").write_text(CONFIG)
    _boxlift("train", folder / "run.toml", "--out", folder / "run")
    _boxlift("export", folder / "run", "--out", folder / "head.onnx", *ABOUT)
    return folder


@pytest.fixture(scope="module")
def frames(folder: Path) -> list[TrainingFrame]:
    data = read_config(folder / "run.toml").settings.data
    return [judged.frame for judged in load_judged(data.validate_on, data)]


def _boxlift(*arguments: object) -> None:
    with pytest.raises(SystemExit) as exit_:
        main([str(argument) for argument in arguments])
    assert not exit_.value.code


def _prompts(frame: TrainingFrame) -> tuple[Prompt, ...]:
    return tuple(
        Prompt(CLASSES[category], tuple(box_px), score)
        for category, box_px, score in zip(
            frame.category, frame.boxes_px.tolist(), frame.score.tolist(), strict=True
        )
    )


@cache
def _opened(path: Path) -> Monocular:
    return Monocular.open(path)


def _detect(path: Path, frame: TrainingFrame, prompts: tuple[Prompt, ...] | None) -> FrameLabels:
    calibration = Calibration(frame.image_P_cam, np.eye(4))
    return _opened(path).detect(frame.name, frame.read_image(), calibration, prompts)


def test_loss_falls(folder: Path) -> None:
    curve = [json.loads(line) for line in (folder / "run" / "metrics.jsonl").read_text().splitlines()]
    assert len(curve) == EPOCHS
    for term in ("loss", "loss/depth", "loss/angle", "loss/object"):
        assert curve[-1][term] < curve[0][term], term
    assert curve[-1]["loss"] < 0.7 * curve[0]["loss"] or curve[-1]["loss"] < curve[0]["loss"] - 0.5
    # Geometry alone is near, so what was learned on the same frames is.
    assert curve[-1]["Car/depth_error"] < 0.08
    assert curve[-1]["Car/recall_2d"] == 1


def test_predictions_are_written(folder: Path, frames: list[TrainingFrame]) -> None:
    written = folder / "run" / "predictions" / "data"
    assert sorted(path.stem for path in written.iterdir()) == [frame.name for frame in frames]
    lifter = build_lifter(read_config(folder / "run.toml").settings.model)
    lifter.load_state_dict(_trained(folder))
    for frame in frames:
        lines = kitti_label.read_file(written / f"{frame.name}.txt")
        assert [line.category for line in lines] == [CLASSES[category] for category in frame.category]
        assert all(line.score is not None and 0 < line.score < 1 for line in lines)
        expected = lift_frame(lifter.eval(), FrozenTrunk(), frame)
        assert kitti_label.to_text(expected) == (written / f"{frame.name}.txt").read_text()


def _trained(folder: Path) -> dict[str, torch.Tensor]:
    checkpoint = read_checkpoint(folder / "run" / "checkpoint.pt")
    assert checkpoint is not None
    return checkpoint.model


def test_features_are_normalised_by_what_was_seen(folder: Path) -> None:
    states = _trained(folder)
    assert states["mean"].abs().max() > 0.01
    assert (states["deviation"] > 0).all()
    assert not torch.equal(states["deviation"], torch.ones_like(states["deviation"]))


def test_exported_head_is_the_trained_one(folder: Path) -> None:
    """Its parameters rounded to 16-bit floats, what it normalises by as it was."""
    lifter = read_lifter(folder / "head.onnx")
    trained = _trained(folder)
    rounded = {name for name, _ in lifter.named_parameters()}
    assert lifter.state_dict().keys() == trained.keys()
    for name, values in lifter.state_dict().items():
        expected = trained[name].half().float() if name in rounded else trained[name]
        assert torch.equal(values, expected), name


@pytest.mark.parametrize("name", ["head.onnx", "head_small.onnx"])
def test_exported_pair_is_opened_and_run(folder: Path, frames: list[TrainingFrame], name: str) -> None:
    model = _opened(folder / name)
    assert model.classes == CLASSES
    assert model.metadata["training_data"] == "three generated frames"
    assert model.metadata["licence"] == "none"
    found = 0
    for frame in frames:
        prompts = _prompts(frame)
        lifted = _detect(folder / name, frame, prompts)
        assert [label.prompt for label in lifted.objects] == list(prompts)
        assert {label.result for label in lifted.objects} == {Result.PREDICTED}
        assert all("heading_ambiguous" in label.flags for label in lifted.objects)
        assert _detect(folder / name, frame, ()).objects == ()
        alone = _detect(folder / name, frame, None)
        assert all(label.result is Result.PREDICTED for label in alone.objects)
        found += len(alone.objects)
    assert found >= 5


def test_small_variant_says_nearly_the_same(folder: Path, frames: list[TrainingFrame]) -> None:
    assert (folder / "head_small.onnx").stat().st_size < 0.7 * (folder / "head.onnx").stat().st_size
    for frame in frames:
        full, small = (
            np.array([label.box.center_cam[0] for label in lifted.objects if label.box is not None])
            for lifted in (
                _detect(folder / name, frame, _prompts(frame)) for name in ("head.onnx", "head_small.onnx")
            )
        )
        assert np.median(np.abs(small[:, 2] / full[:, 2] - 1)) < 0.01


@pytest.mark.parametrize(
    "categories", ['["Car"]', '["Car", "Pedestrian", "Truck", "Cyclist"]', '["Car", "Van"]']
)
def test_other_classes_than_the_heads_are_refused(folder: Path, categories: str) -> None:
    path = folder / "classes.toml"
    path.write_text(CONFIG.replace("[rows]", f"[data]\ncategories = {categories}\n[rows]"))
    with pytest.raises(OptionsError, match=r"data\.categories.*Pedestrian"):
        read_config(path).make_task(folder / "classes")


def test_no_frames_are_named(tmp_path: Path) -> None:
    (tmp_path / "empty.toml").write_text('task = "lifter"')
    with pytest.raises(OptionsError, match=r"data\.train"):
        read_config(tmp_path / "empty.toml").make_task(tmp_path / "run")


def test_epochs_take_a_share_of_the_rows(folder: Path) -> None:
    path = folder / "share.toml"
    path.write_text(CONFIG.replace("share = 1.0", "share = 0.5"))
    config = read_config(path)
    task = LifterTask(config.settings, folder / "share")
    whole = LifterTask(read_config(folder / "run.toml").settings, folder / "run")
    counts = [
        [len(batch) for batch in each.batches(0, torch.Generator().manual_seed(0))] for each in (task, whole)
    ]
    assert set(counts[0]) == set(counts[1]) == {32}
    assert len(counts[0]) == pytest.approx(len(counts[1]) / 2, abs=1)


def test_settings_build_the_head() -> None:
    lifter = build_lifter(LifterModelSettings(blind_voices=1, seeing_voices=2, channels=4, sizes="learned"))
    assert isinstance(lifter, Lifter)
    assert (len(lifter.voices), lifter.blind, lifter.learn_sizes) == (3, 1, True)
