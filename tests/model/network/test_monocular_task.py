from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from boxlift import Calibration, Prompt
from boxlift.errors import OptionsError
from boxlift.formats import kitti_label
from boxlift.monocular import Monocular
from boxlift.network.checkpoint import Curve
from boxlift.network.judging import predict
from boxlift.network.monocular_task import build_network
from boxlift.network.tasks import export_run, read_config
from boxlift.network.trainer import train
from boxlift.network.training_frames import load_judged
from model.network.generated_data import toml, write_frames

TRAINER = "epochs = {epochs}\nbatch_size = 2\nlearning_rate = {rate}\nevaluate_every = 0\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("training")
    write_frames(folder / "data")
    return folder


def _train(folder: Path, out: str, text: str) -> Curve:
    path = folder / f"{out}.toml"
    path.write_text(text)
    config = read_config(path)
    _, curve = train(
        config.make_task(folder / out), config.settings.trainer, folder / out, config.fingerprint
    )
    return curve


@pytest.mark.parametrize("backbone", ["resnet18", "resnet34", "resnet50", "nanodet"])
def test_paper_overfits_two_frames(folder: Path, backbone: str) -> None:
    """Every backbone trains: the losses on the points of two frames fall."""
    epochs = 15 if backbone == "nanodet" else 6
    text = toml(
        model=f'backbone = "{backbone}"\nhidden = 32', trainer=TRAINER.format(epochs=epochs, rate=3e-4)
    )
    curve = _train(folder, backbone, text)
    assert curve[-1]["loss"] < 0.8 * curve[0]["loss"]
    assert {"loss/alignment", "loss/y", "loss/orientation", "Car/depth_error"} <= set(curve[-1])


@pytest.mark.parametrize("targets", ["points", "label_2"])
@pytest.mark.parametrize("network", ["two_stage", "one_stage"])
def test_frozen_features_overfit_two_frames(folder: Path, network: str, targets: str) -> None:
    curve = _train(
        folder,
        f"{network}_{targets}",
        toml(
            data=f'targets = "{targets}"',
            model=f'network = "{network}"\nbackbone = "nanodet"\nfreeze_backbone = true\n'
            'roi_strides = [8, 16]\nhidden = 64\nsizes = "learned"',
            trainer=TRAINER.format(epochs=60, rate=1e-3),
        ),
    )
    assert curve[-1]["loss"] < 0.4 * curve[0]["loss"]
    written = sorted((folder / f"{network}_{targets}" / "predictions" / "data").glob("*.txt"))
    assert [path.stem for path in written] == ["000000", "000001"]
    assert all(line.score is not None for path in written for line in kitti_label.read_file(path))


def test_exports_to_the_monocular_interface(folder: Path) -> None:
    """A trained network becomes a file that the wrapper opens, and says what torch says."""
    _train(
        folder,
        "exported",
        toml(
            model='backbone = "resnet18"\nhidden = 16\ndepth = "box_height"',
            trainer=TRAINER.format(epochs=1, rate=1e-4),
        ),
    )
    path = folder / "model.onnx"
    export_run(folder / "exported", path, {"training_data": "two generated frames", "licence": "none"})
    model = Monocular.open(path)
    assert model.classes == ("Car",)
    assert model.metadata["training_data"] == "two generated frames"
    assert float(model.metadata["focal_px"]) == 240

    config = read_config(folder / "exported.toml")
    frames = load_judged(config.settings.data.validate_on, config.settings.data)
    network = build_network(config.settings.model, 1)
    network.load_state_dict(torch.load(folder / "exported" / "checkpoint.pt")["model"])
    frame = frames[0].frame
    prompts = [Prompt("Car", tuple(box)) for box in frame.boxes_px.tolist()]
    calibration = Calibration(frame.image_P_cam, np.eye(4))
    lifted = model.detect(frame.name, frame.read_image(), calibration, prompts)
    expected = predict(network.eval(), frame, ("Car",))
    assert len(lifted.objects) == len(expected) > 0
    for label, line in zip(lifted.objects, expected, strict=True):
        assert label.box is not None
        # The lines were adjusted along y and rounded to centimetres.
        np.testing.assert_allclose(
            label.box.center_cam[0, [0, 2]], np.array(line.bottom_center_cam)[[0, 2]], atol=0.02
        )
        assert label.box.rotation_y[0] == pytest.approx(line.rotation_y, abs=0.01)
    assert model.detect(frame.name, frame.read_image(), calibration).frame_name == frame.name


def test_run_that_cannot_be_exported_is_named(tmp_path: Path) -> None:
    with pytest.raises(OptionsError, match="holds no run"):
        export_run(tmp_path, tmp_path / "model.onnx", {})


def test_learns_from_augmented_frames(folder: Path) -> None:
    text = toml(
        model='backbone = "nanodet"\nfreeze_backbone = true\nhidden = 32\ndepth = "box_height"',
        augmentation="flip = 0.5\nfocal = 0.2\nscale = 0.2\ncolor = 0.3",
        trainer=TRAINER.format(epochs=3, rate=1e-3),
    )
    assert len(_train(folder, "augmented", text)) == 3


def test_settings_that_do_not_go_together_are_named(folder: Path) -> None:
    text = toml(model='network = "one_stage"\ndepth = "box_height"', trainer=TRAINER.format(epochs=1, rate=1))
    with pytest.raises(OptionsError, match=r"model\.depth"):
        _train(folder, "together", text)


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("task = 'other'", "task"),
        ("[trainer]\nepochs = 0", "trainer.epochs"),
        ("[model]\nbackbone = 'vgg'", "model.backbone"),
        ("[modell]", "modell"),
        ("[[data.train]]", "data.train.0.source"),
        ("not toml", "TOML"),
    ],
)
def test_wrong_configuration_is_named(tmp_path: Path, text: str, where: str) -> None:
    (tmp_path / "wrong.toml").write_text(text)
    with pytest.raises(OptionsError, match=where):
        read_config(tmp_path / "wrong.toml")


def test_missing_configuration_is_named(tmp_path: Path) -> None:
    with pytest.raises(OptionsError, match=r"missing\.toml"):
        read_config(tmp_path / "missing.toml")


def test_no_frames_are_named(tmp_path: Path) -> None:
    (tmp_path / "empty.toml").write_text("")
    with pytest.raises(OptionsError, match=r"data\.train"):
        read_config(tmp_path / "empty.toml").make_task(tmp_path / "run")


def test_empty_file_is_the_papers_training(tmp_path: Path) -> None:
    (tmp_path / "empty.toml").write_text("")
    settings = read_config(tmp_path / "empty.toml").settings.trainer
    assert (settings.optimizer, settings.learning_rate, settings.schedule) == ("adam", 1e-4, "constant")
    assert (settings.epochs, settings.batch_size) == (50, 8)


def test_fingerprint_changes_with_settings_and_not_with_the_machine(tmp_path: Path) -> None:
    path = tmp_path / "run.toml"
    prints = []
    for text in ("seed = 1", "seed = 1\nmachine.threads = 2", "seed = 2"):
        path.write_text(f"[trainer]\n{text}")
        prints.append(read_config(path).fingerprint)
    assert prints[0] == prints[1] != prints[2]
    torch.set_num_threads(1)
