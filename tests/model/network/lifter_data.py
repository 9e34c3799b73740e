"""Generated frames with prompts for all classes of the shipped head, and rows made of them."""

from __future__ import annotations

from pathlib import Path

from boxlift.datasets.generated import generate
from boxlift.datasets.generated.write import write_dataset
from boxlift.network.config import DataSettings, FrameSet
from boxlift.network.detections import CLASSES
from boxlift.network.training_frames import TrainingFrame, load_frames
from model.network.generated_data import SMALL_RIG

SEEDS = (3, 5, 8)


def write_frames(root: Path) -> Path:
    """The folder of a dataset of a small camera, whose truth serves as prompts."""
    write_dataset(root, [generate(seed, SMALL_RIG) for seed in SEEDS])
    return root


def data_settings(source: Path, targets: str = "label_2") -> DataSettings:
    """Trains on the dataset, and is judged on it."""
    frames = FrameSet(source=source)
    return DataSettings.model_validate(
        {"targets": targets, "categories": CLASSES, "train": (frames,), "validate_on": (frames,)}
    )


def training_frames(source: Path, targets: str = "label_2") -> list[TrainingFrame]:
    """The frames with what supervises them."""
    settings = data_settings(source, targets)
    return load_frames(settings.train, settings, None)
