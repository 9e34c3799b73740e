"""The paper's training as a Task, and what it is compared with: other targets, a one-stage network."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from boxlift.errors import OptionsError
from boxlift.formats import kitti_label
from boxlift.network.batch import FrameBatch
from boxlift.network.centernet import CenterNetwork, detection_loss, object_cells, parameters_at
from boxlift.network.config import AugmentationSettings, ModelSettings, MonocularSettings
from boxlift.network.direct_loss import box_loss, direct_loss
from boxlift.network.frame_batches import FrameBatches
from boxlift.network.frozen_maps import FrozenMaps, KnownMaps
from boxlift.network.judging import judge, predict
from boxlift.network.paper_head import PaperNetwork
from boxlift.network.training_frames import load_frames, load_judged

TARGETS_NAME = "targets.npz"
PREDICTIONS_NAME = "predictions"


class MonocularTask:
    """Trains a PaperNetwork or a CenterNetwork on frames.

    `folder` keeps targets.npz, what was extracted for the frames, and predictions/data/, what the model saw
    in the judged frames when it was last evaluated (KITTI result files).

    Raises OptionsError where no frame has a usable 2D box, DatasetError where files are missing.
    """

    def __init__(
        self, settings: MonocularSettings, folder: Path, known_maps: KnownMaps | None = None
    ) -> None:
        """`known_maps`: maps of a frozen backbone, to be shared by trainings on the same one."""
        data, loss = settings.data, settings.loss
        self._settings = settings
        self._folder = folder
        self._known_maps: KnownMaps = {} if known_maps is None else known_maps
        self._frozen_maps: FrozenMaps | None = None
        frames = load_frames(data.train, data, folder / TARGETS_NAME)
        if not frames:
            raise OptionsError(
                "data.train", "no frame has LiDAR and a usable 2D box.", "Add a [[data.train]] with frames."
            )
        self._focal_px = float(np.median([frame.image_P_cam[1, 1] for frame in frames]))
        self._judged = load_judged(data.validate_on, data)
        self._batches = FrameBatches(
            frames,
            data.categories,
            settings.trainer.batch_size,
            settings.augmentation,
            rays_from_lidar=loss.alignment.ray_origin == "lidar",
            threads=settings.trainer.machine.threads,
        )

    def build(self, rng: torch.Generator) -> nn.Module:  # noqa: ARG002 - layers draw from torch's own
        """See Task."""
        model = build_network(self._settings.model, len(self._settings.data.categories))
        still = self._settings.augmentation == AugmentationSettings()
        if isinstance(model, PaperNetwork):
            model.focal_px.fill_(self._focal_px)
        if model.backbone.frozen and still:
            self._frozen_maps = FrozenMaps(model.backbone, self._known_maps)
        return model

    def batches(self, epoch: int, generator: torch.Generator) -> Iterator[FrameBatch]:  # noqa: ARG002
        """See Task."""
        return self._batches.shuffled(generator, self._frozen_maps)

    def loss(self, model: nn.Module, batch: FrameBatch) -> dict[str, Tensor]:
        """See Task."""
        settings, objects = self._settings.loss, batch.objects
        terms: dict[str, Tensor] = {}
        if self._settings.model.network == "one_stage":
            maps = model(batch.images)
            detection = detection_loss(maps, batch, settings.extent_weight)
            terms = {**detection, "heat": settings.heat_weight * detection["heat"]}
            parameters = parameters_at(maps, *object_cells(batch, maps))
        else:
            boxes_px, sizes_m = batch.split(objects.boxes_px), batch.split(objects.frozen_size_m)
            parameters = model(batch.images, batch.image_P_cam, boxes_px, sizes_m)
        loss = direct_loss if self._settings.data.targets == "points" else box_loss
        overlap = self._settings.model.orientation_overlap
        return terms | loss(parameters, objects, batch.projections(), settings, overlap)

    def evaluate(self, model: nn.Module) -> dict[str, float]:
        """See Task: KITTI's figures on `validate_on`, by class."""
        if not self._judged:
            return {}
        categories = self._settings.data.categories
        predictions = [predict(model, judged.frame, categories) for judged in self._judged]
        out = self._folder / PREDICTIONS_NAME / "data"
        out.mkdir(parents=True, exist_ok=True)
        for judged, found in zip(self._judged, predictions, strict=True):
            (out / f"{judged.frame.name}.txt").write_text(kitti_label.to_text(found), encoding="utf-8")
        return judge(predictions, [judged.truth for judged in self._judged], categories)


def build_network(settings: ModelSettings, classes: int) -> PaperNetwork | CenterNetwork:
    """The network of these settings, untrained. Raises OptionsError where they do not go together."""
    if settings.network == "two_stage":
        return PaperNetwork(settings)
    if settings.depth == "box_height":
        raise OptionsError(
            "model.depth", "a one_stage network has no 2D box to take a height from.", "Give features."
        )
    return CenterNetwork(settings, classes)
