"""The service as a running process."""

from __future__ import annotations

import os
from copy import deepcopy

from boxlift.errors import MissingExtraError
from boxlift_service.settings import ServiceSettings


def run(settings: ServiceSettings) -> None:
    """Serve until SIGINT or SIGTERM; requests that were accepted are answered first.

    Logs "Uvicorn running on http://HOST:PORT" to stderr once it listens, with the port that was taken
    where settings.port is 0. Raises MissingExtraError without the extra `serve`.
    """
    # OpenMP reads it once, when Open3D and torch load. Threads that spin while they wait made
    # the ground plane 2 to 5 times slower on a machine that was busy otherwise.
    os.environ["OMP_NUM_THREADS"] = str(settings.label_threads)
    try:
        import uvicorn

        from boxlift_service.app import create_app
    except ModuleNotFoundError as error:
        raise MissingExtraError(error.name or "fastapi", "serve") from None

    log_config = deepcopy(uvicorn.config.LOGGING_CONFIG)
    log_config["loggers"]["boxlift_service"] = {"handlers": ["default"], "level": settings.log_level.upper()}
    # It would log a line for every malformed form, and the answer says it already.
    log_config["loggers"]["python_multipart"] = {"handlers": ["default"], "level": "ERROR"}
    uvicorn.run(
        create_app(settings),
        host=settings.host,
        port=settings.port,
        log_level=settings.log_level,
        log_config=log_config,
        timeout_keep_alive=settings.keep_alive_s,
        server_header=False,
        http="h11",  # the implementation that the lingering close was tested with
        ws="none",
    )
