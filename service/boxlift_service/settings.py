"""Every knob of the service, frozen, typed and documented once."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

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
    label_workers: int = Field(
        1, ge=1, le=64, description="Processes that label: frames labelled at the same time."
    )
    label_threads: int = Field(
        1, ge=1, le=256, description="CPU threads of torch and Open3D in each of them."
    )
    detect_workers: int = Field(1, ge=1, le=64, description="Processes that find objects in images.")
    detect_threads: int = Field(2, ge=1, le=256, description="CPU threads of ONNX Runtime in each of them.")
    model: Path | None = Field(
        None, description="ONNX file of the monocular model of POST /detect; the one that ships where unset."
    )
    detector: Path | None = Field(
        None,
        description="ONNX file of the 2D detector, used where no prompts come along; where it is unset, "
        "POST /label takes the one that ships, and POST /detect what the monocular model finds itself.",
    )
    max_images: int = Field(16, ge=1, le=1024, description="Most images of a POST /detect.")
    min_score: float = Field(
        0.0, ge=0, le=1, description="Least score of what POST /detect finds, where a request names none."
    )
    priors: Path | None = Field(
        None, description="TOML file with sizes per class, laid over the built-in ones; read at the start."
    )

    # What people review
    label_sets: Path | None = Field(
        None,
        description="Folder of label sets (or one label set) that the review page opens, and where dropped "
        "frames are kept; unset: ./boxlift-review on loopback, else no review page.",
    )
    corrections: str | None = Field(
        None,
        description="Database of all corrections as a URL of SQLAlchemy, e.g. postgresql+psycopg://...; "
        "unset: corrections.sqlite in each label set.",
    )

    # Work
    permits_per_worker: float = Field(
        16.0,
        gt=0,
        le=1e6,
        description="Work that is taken on at a time, for each worker; 429 beyond it. A permit is a million "
        "objects x points of POST /label, or an image to find objects in.",
    )
    frame_limit_s: float = Field(
        60.0, gt=0, le=3600, description="Longest computing of a request; its worker is replaced beyond it."
    )
    silence_s: float = Field(
        3.0, ge=1, le=600, description="A worker that is not heard from for this long is replaced."
    )
    max_held_bytes: int = Field(
        2**30, ge=2**20, description="Most bytes of all bodies together that are held; 429 beyond it."
    )
    receive_idle_s: float = Field(
        15.0, gt=0, le=3600, description="A body that brings nothing for this long is refused with 408."
    )
    receive_limit_s: float = Field(
        120.0,
        gt=0,
        le=86_400,
        description="Longest time for a body to come in, and for a client to take nothing of its answer; "
        "headers have 15 s at most.",
    )
    max_connections: int = Field(1000, ge=1, description="Most connections that are open at a time.")
    drain_s: float = Field(
        0.0, ge=0, le=3600, description="After SIGTERM, serve on for this long while /readyz says 503."
    )

    # Who may ask
    api_keys: Path | None = Field(
        None,
        description="File of hashed API keys, read again when it changes; no keys are asked for where unset.",
    )
    allow_anonymous: bool = Field(
        False,
        description="Listen beyond loopback without API keys, e.g. behind a proxy that asks for its own.",
    )
    requests_per_minute: int = Field(
        0,
        ge=0,
        description="Requests of a key in a minute, where its line names none: as many at once, then evenly; "
        "0: no limit.",
    )
    open_metrics: bool = Field(False, description="Serve /metrics without a key.")
    allowed_origins: tuple[str, ...] = Field(
        (), description="Origins whose pages may call (CORS), separated by commas; none where empty."
    )

    # What is told
    log_format: Literal["text", "json"] = Field(
        "text", description="A log line as text, or as a JSON object."
    )
    tracing: bool = Field(
        False, description="Send OpenTelemetry traces (extra otel; OTEL_* variables say where to)."
    )

    # What is fetched
    fetch_from: tuple[str, ...] = Field(
        (),
        description="URL prefixes that POST /pointCloud/recognition may fetch from, separated by commas; "
        "the route refuses every URL where empty.",
    )
    fetch_private: bool = Field(
        False, description="Let those prefixes name private addresses, e.g. a MinIO beside the service."
    )
    fetch_limit_s: float = Field(20.0, gt=0, le=600, description="Longest time for a fetch.")

    @field_validator("allowed_origins", "fetch_from", mode="before")
    @classmethod
    def _separated(cls, value: object) -> object:
        if isinstance(value, str):
            return tuple(item.strip() for item in value.split(",") if item.strip())
        return value

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
