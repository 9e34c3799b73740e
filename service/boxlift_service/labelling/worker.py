"""What a label worker holds: the labeller's libraries, loaded and shown to work."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from boxlift.settings import LabellerSettings
from boxlift_service.settings import ServiceSettings
from boxlift_service.telemetry.logs import configure_logging


@dataclass(frozen=True)
class LabelWorker:
    """The limits that its requests keep, and the presets that they choose from."""

    limits: ServiceSettings
    presets: Mapping[str, LabellerSettings]


def open_label_worker(limits: ServiceSettings, presets: Mapping[str, LabellerSettings]) -> LabelWorker:
    """Set the number of threads and label a frame. Raises what the labeller raises."""
    configure_logging(limits.log_format, limits.log_level)
    import torch

    from boxlift_service.labelling.warm_up import warm_up

    torch.set_num_threads(limits.label_threads)
    warm_up()
    return LabelWorker(limits, presets)
