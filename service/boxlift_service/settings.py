"""Every knob of the service, frozen, typed and documented once."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from boxlift.errors import OptionsError

ENVIRONMENT_PREFIX = "BOXLIFT_"


class ServiceSettings(BaseModel):
    """Where the service listens, what it accepts and what it may use.

    Every field is also an environment variable: `max_points` is BOXLIFT_MAX_POINTS.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    host: str = Field("127.0.0.1", description="Address to listen on; 0.0.0.0 is every IPv4 address.")
    port: int = Field(8000, ge=0, le=65_535, description="Port to listen on; 0 takes a free one.")
    log_level: Literal["debug", "info", "warning", "error"] = Field("info", description="Least level logged.")
    keep_alive_s: int = Field(30, ge=1, le=3600, description="Idle connections are closed after this time.")
    linger_s: float = Field(
        10.0, ge=0, le=300, description="How long to read on from a client that still sends a refused body."
    )
    max_body_bytes: int = Field(64 * 2**20, ge=1024, description="Largest request body; 413 beyond it.")
    max_points: int = Field(2_000_000, ge=1, description="Most LiDAR points of a frame.")
    max_image_pixels: int = Field(64_000_000, ge=1, description="Most pixels of an image or a mask image.")
    max_prompts: int = Field(1000, ge=1, le=65_535, description="Most prompts of a frame.")
    worker_threads: int = Field(1, ge=1, le=64, description="Frames that are labelled at the same time.")
    threads_per_worker: int = Field(
        1, ge=1, le=256, description="CPU threads of torch and Open3D in a worker."
    )
    model: Path | None = Field(
        None, description="ONNX file of the monocular model of POST /detect; the one that ships where unset."
    )
    detector: Path | None = Field(
        None,
        description="ONNX file of the 2D detector, used where no prompts come along; where it is unset, "
        "POST /label takes the one that ships, and POST /detect what the monocular model finds itself.",
    )
    detect_threads: int = Field(2, ge=1, le=256, description="CPU threads of ONNX Runtime.")
    max_images: int = Field(16, ge=1, le=1024, description="Most images of a POST /detect.")
    min_score: float = Field(
        0.0, ge=0, le=1, description="Least score of what POST /detect finds, where a request names none."
    )
    priors: Path | None = Field(
        None, description="TOML file with sizes per class, laid over the built-in ones; read at the start."
    )

    @classmethod
    def from_environment(cls, environment: Mapping[str, str] = os.environ) -> ServiceSettings:
        """Defaults, with BOXLIFT_* variables laid over them. Raises OptionsError that names the variable."""
        given = {
            name: environment[variable]
            for name in cls.model_fields
            if (variable := f"{ENVIRONMENT_PREFIX}{name.upper()}") in environment
        }
        try:
            return cls.model_validate(given)
        except ValidationError as error:
            first = error.errors()[0]
            raise OptionsError(
                f"{ENVIRONMENT_PREFIX}{str(first['loc'][0]).upper()}",
                f"{first['msg']} (got {first['input']!r:.80}).",
                "Correct the environment variable or unset it.",
            ) from None
