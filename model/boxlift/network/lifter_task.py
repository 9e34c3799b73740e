"""The training of the head that ships as a Task: pseudo labels, a frozen trunk, features made once."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from boxlift.boxes import Boxes3D
from boxlift.detector import DEFAULT_FILE
from boxlift.errors import OptionsError
from boxlift.formats import kitti_label
from boxlift.formats.kitti_label import KittiObject, from_box3d
from boxlift.network import onnx_files
from boxlift.network.config import LifterModelSettings, LifterSettings
from boxlift.network.detections import CLASSES
from boxlift.network.graphs import PaddedTrunk
from boxlift.network.judging import judge
from boxlift.network.lifter import Lifter
from boxlift.network.lifter_loss import lifter_loss
from boxlift.network.lifter_rows import Rows, rows_of_frame
from boxlift.network.monocular_task import PREDICTIONS_NAME, TARGETS_NAME
from boxlift.network.nanodet import NanoDetTrunk
from boxlift.network.training_frames import TrainingFrame, load_frames, load_judged

Maps = tuple[Tensor, Tensor, Tensor]


class FrozenTrunk:
    """NanoDet's trunk with the weights of the detector that comes with boxlift."""

    def __init__(self) -> None:
        trunk = NanoDetTrunk()
        onnx_files.load_weights(trunk, onnx_files.read_weights(DEFAULT_FILE), "trunk.trunk.")
        self._trunk = PaddedTrunk(trunk.eval().requires_grad_(False))

    @torch.no_grad()
    def __call__(self, image: NDArray[np.uint8]) -> Maps:
        """(H, W, 3) uint8 RGB -> its maps."""
        maps: Maps = self._trunk(torch.from_numpy(image))
        return maps


class LifterTask:
    """Trains a Lifter. `folder` keeps targets.npz and predictions/data/ as a MonocularTask's does.

    Raises OptionsError where no frame has a usable 2D box, DatasetError where files are missing.
    """

    def __init__(self, settings: LifterSettings, folder: Path) -> None:
        data = settings.data
        self._settings = settings
        self._folder = folder
        if tuple(data.categories) != CLASSES:
            raise OptionsError("data.categories", f"{data.categories} are given.", f"Give {list(CLASSES)}.")
        frames = load_frames(data.train, data, folder / TARGETS_NAME)
        if not frames:
            raise OptionsError(
                "data.train", "no frame has LiDAR and a usable 2D box.", "Add a [[data.train]] with frames."
            )
        self._judged = load_judged(data.validate_on, data)
        self._trunk = FrozenTrunk()
        self._rows = Rows.joined(
            [
                rows_of_frame(frame, self._trunk, settings.rows, settings.augmentation, settings.trainer.seed)
                for frame in frames
            ]
        )

    def build(self, rng: torch.Generator) -> nn.Module:  # noqa: ARG002 - layers draw from torch's own
        """See Task."""
        model = build_lifter(self._settings.model)
        sample = self._rows.rois[:: max(1, len(self._rows) // 4000)].float()
        model.mean.copy_(sample.mean((0, 2, 3), keepdim=True))
        model.deviation.copy_(sample.std((0, 2, 3), keepdim=True).clamp(min=1e-3))
        return model

    def batches(self, epoch: int, generator: torch.Generator) -> Iterator[Rows]:  # noqa: ARG002
        """See Task: each epoch a random `share` of the rows."""
        size = self._settings.trainer.batch_size
        order = torch.randperm(len(self._rows), generator=generator)
        order = order[: max(size, round(len(order) * self._settings.share))]
        for start in range(0, len(order) - size + 1, size) if len(order) >= size else [0]:
            yield self._rows.of(order[start : start + size])

    def loss(self, model: nn.Module, batch: Rows) -> dict[str, Tensor]:
        """See Task."""
        return lifter_loss(model(batch.geometry, batch.rois.float()), batch)

    @torch.no_grad()
    def evaluate(self, model: nn.Module) -> dict[str, float]:
        """See Task: KITTI's figures on `validate_on`, by class."""
        if not self._judged:
            return {}
        assert isinstance(model, Lifter)
        predictions = [lift_frame(model, self._trunk, judged.frame) for judged in self._judged]
        out = self._folder / PREDICTIONS_NAME / "data"
        out.mkdir(parents=True, exist_ok=True)
        for judged, found in zip(self._judged, predictions, strict=True):
            (out / f"{judged.frame.name}.txt").write_text(kitti_label.to_text(found), encoding="utf-8")
        return judge(predictions, [judged.truth for judged in self._judged], CLASSES)


def build_lifter(settings: LifterModelSettings) -> Lifter:
    """The head of these settings, untrained."""
    return Lifter(
        settings.blind_voices,
        settings.seeing_voices,
        settings.channels,
        settings.width,
        settings.dropout,
        learn_sizes=settings.sizes == "learned",
    )


@torch.no_grad()
def lift_frame(model: Lifter, trunk: FrozenTrunk, frame: TrainingFrame) -> list[KittiObject]:
    """The 2D boxes of a frame lifted."""
    image = frame.read_image()
    size = torch.tensor(float(image.shape[1])), torch.tensor(float(image.shape[0]))
    lifted = model.lift(
        trunk(image),
        torch.from_numpy(frame.boxes_px).float(),
        torch.from_numpy(frame.category),
        torch.from_numpy(frame.score).float(),
        torch.tensor(frame.image_P_cam, dtype=torch.float32),
        size,
    )
    centers, sizes, headings = (
        column.double().numpy() for column in (lifted.centers_cam, lifted.sizes_m, lifted.rotations_y)
    )
    length, width, height = sizes.T
    boxes = Boxes3D(centers, length, width, height, headings)
    return [
        from_box3d(CLASSES[category], tuple(box_px), boxes[row : row + 1], float(lifted.scores[row]))
        for row, (category, box_px) in enumerate(zip(frame.category, frame.boxes_px.tolist(), strict=True))
    ]
