from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

from boxlift.detector import DEFAULT_FILE
from boxlift.errors import OptionsError
from boxlift.network import onnx_files
from boxlift.network.backbones import STRIDES, Backbone, BackboneName
from boxlift.network.config import ModelSettings
from boxlift.network.paper_head import PaperNetwork
from boxlift.network.resnet import ResNet
from model.network.exporting import padded, run_exported

# Parameters of the whole networks (torchvision's documentation) less those of layer4 and fc.
RESNET_PARAMETERS = {
    "resnet18": 11_689_512 - 8_393_728 - 513_000,
    "resnet34": 21_797_672 - 13_114_368 - 513_000,
    "resnet50": 25_557_032 - 14_964_736 - 2_049_000,
}
CHANNELS: dict[BackboneName, tuple[int, int]] = {
    "resnet18": (128, 256),
    "resnet34": (128, 256),
    "resnet50": (512, 1024),
    "nanodet": (128, 128),
}


@pytest.mark.parametrize("name", CHANNELS)
def test_maps_have_their_strides_and_channels(name: BackboneName) -> None:
    backbone = Backbone(name).eval()
    assert backbone.channels == CHANNELS[name]
    maps = backbone(torch.rand(2, 3, 64, 96) * 255)
    expected = [
        (2, channels, 64 // stride, 96 // stride)
        for channels, stride in zip(CHANNELS[name], STRIDES, strict=True)
    ]
    assert [tuple(level.shape) for level in maps] == expected


@pytest.mark.parametrize("name", RESNET_PARAMETERS)
def test_parameters_are_those_of_the_original(name: str) -> None:
    assert sum(p.numel() for p in ResNet(name).parameters()) == RESNET_PARAMETERS[name]


@pytest.mark.parametrize("name", CHANNELS)
def test_network_exports_on_every_backbone(name: BackboneName) -> None:
    """The whole network, prompts given: images and boxes of any number come out as in torch."""

    class Lifted(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            strides = (8, 16) if name == "nanodet" else (16,)
            self.network = PaperNetwork(ModelSettings(backbone=name, hidden=8, roi_strides=strides))

        def forward(self, image: Tensor, P: Tensor, boxes: Tensor, sizes: Tensor) -> tuple[Tensor, ...]:
            return tuple(self.network(padded(image), P, [boxes], [sizes]))

    torch.manual_seed(0)
    calls = []
    for count, height, width in ((3, 60, 90), (1, 96, 160), (0, 70, 96)):
        image = torch.rand(1, 3, height, width) * 255
        P = torch.tensor([[[60.0, 0, 48, 0], [0, 60, 32, 0], [0, 0, 1, 0]]])
        boxes = torch.rand(count, 4) * 30 + torch.tensor([0.0, 0, 31, 31])
        calls.append((image, P, boxes, torch.tensor([[4.0, 1.8, 1.6]]).repeat(count, 1)))
    module = Lifted().eval()
    free: tuple[dict[int, str], ...] = ({2: "height", 3: "width"}, {}, {0: "boxes"}, {0: "boxes"})
    for call, exported in zip(calls, run_exported(module, calls[0], free, *calls), strict=True):
        with torch.no_grad():
            expected = module(*call)
        for ours, theirs in zip(expected, exported, strict=True):
            torch.testing.assert_close(ours, theirs, atol=1e-3, rtol=1e-4)


def test_whole_state_dict_loads_without_its_last_stage(tmp_path: Path) -> None:
    states = ResNet("resnet18").state_dict()
    assert {"conv1.weight", "bn1.running_var", "layer2.0.downsample.1.bias", "layer3.1.conv2.weight"} <= set(
        states
    )
    rest = {"layer4.0.conv1.weight": torch.zeros(512, 256, 3, 3), "fc.weight": torch.zeros(1000, 512)}
    torch.save({**states, **rest}, tmp_path / "resnet18.pth")
    loaded = Backbone("resnet18", tmp_path / "resnet18.pth").body.state_dict()
    assert all(torch.equal(loaded[name], states[name]) for name in states)


def test_state_dict_of_another_network_is_named(tmp_path: Path) -> None:
    torch.save(ResNet("resnet34").state_dict(), tmp_path / "resnet34.pth")
    (tmp_path / "text.pth").write_text("no weights")
    for file in ("resnet34.pth", "text.pth", "missing.pth"):
        with pytest.raises(OptionsError, match=file):
            Backbone("resnet18", tmp_path / file)


def test_nanodet_brings_the_weights_of_the_detector() -> None:
    weights = onnx_files.read_weights(DEFAULT_FILE)
    states = Backbone("nanodet").body.state_dict()
    assert torch.equal(states["stem.bias"], torch.from_numpy(weights["trunk.trunk.stem.bias"]))


def test_frozen_backbone_stays_as_it_is() -> None:
    backbone = Backbone("resnet18", frozen=True)
    before = {name: value.clone() for name, value in backbone.state_dict().items()}
    backbone.train()
    maps = backbone(torch.rand(1, 3, 64, 64) * 255)
    assert not maps[0].requires_grad
    assert all(torch.equal(value, before[name]) for name, value in backbone.state_dict().items())
    assert backbone(maps) is maps
