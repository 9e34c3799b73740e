"""Options of the commands that may find prompts in the image."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from boxlift.errors import OptionsError
from boxlift.settings import DetectionSettings, LabellerSettings
from boxlift_client.job import DETECTOR

DetectorOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="ONNX file of a detector of your own (docs/detectors.md).", show_default=False
    ),
]
MinScoreOption = Annotated[
    float | None,
    typer.Option(
        min=0,
        max=1,
        metavar="SCORE",
        help=f"Least score of detections.  [default: {DetectionSettings().min_score:g}]",
    ),
]


def with_detection(
    settings: LabellerSettings, prompts: str | None, detector: Path | None, min_score: float | None
) -> LabellerSettings:
    """The settings with `min_score` where it is given.

    Raises OptionsError where detector or score are given to a command that finds no prompts.
    """
    for name, given in (("detector", detector), ("min-score", min_score)):
        if given is not None and prompts != DETECTOR:
            raise OptionsError(name, f"{str(given)!r} is given without --prompts {DETECTOR}.", "Add that.")
    return settings if min_score is None else settings.with_options({"detection": {"min_score": min_score}})
