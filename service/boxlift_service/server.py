"""The service as a running process."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import threading
from contextlib import suppress
from types import FrameType

from boxlift.errors import MissingExtraError
from boxlift_service.lifecycle import Lifecycle
from boxlift_service.settings import ServiceSettings


def run(settings: ServiceSettings) -> None:
    """Serve until SIGINT or SIGTERM; requests that were accepted are answered first.

    After SIGTERM, /readyz says 503 for settings.drain_s before the port is closed. SIGHUP reloads the models.
    Logs "Uvicorn running on http://HOST:PORT" to stderr once it listens, with the port that was taken where
    settings.port is 0. Raises OptionsError for settings that do not go together, MissingExtraError without
    the extra `serve`.
    """
    with suppress(AttributeError, ValueError):  # no such signal, or not the main thread
        signal.signal(signal.SIGHUP, signal.SIG_IGN)  # until there are models to reload
    # OpenMP reads it once, when Open3D and torch load. Threads that spin while they wait made
    # the ground plane 2 to 5 times slower on a machine that was busy otherwise.
    os.environ["OMP_NUM_THREADS"] = str(settings.label_threads)
    try:
        import uvicorn

        from boxlift_service.app import create_app
        from boxlift_service.guards.connections import Connections, allow_open_files, protocol_class
        from boxlift_service.telemetry.logs import configure_logging
        from boxlift_service.telemetry.metrics import Metrics
    except ModuleNotFoundError as error:
        raise MissingExtraError(error.name or "fastapi", "serve") from None

    configure_logging(settings.log_format, settings.log_level)
    allow_open_files(settings)
    lifecycle, metrics = Lifecycle(), Metrics()
    connections = Connections(settings.max_connections, lambda reason: metrics.count_refused("http", reason))
    metrics.watch("boxlift_connections", "Open connections.", lambda: connections.open)
    app = create_app(settings, metrics, lifecycle)
    config = uvicorn.Config(
        app,
        host=settings.host,
        port=settings.port,
        log_config=None,
        access_log=False,
        timeout_keep_alive=settings.keep_alive_s,
        server_header=False,
        http=protocol_class(settings, connections),
        ws="none",
    )

    class Server(uvicorn.Server):
        """Drains before it stops to listen, and reloads when it is told to."""

        def handle_exit(self, sig: int, frame: FrameType | None) -> None:
            if sig != signal.SIGTERM or lifecycle.draining or settings.drain_s == 0:
                super().handle_exit(sig, frame)
                return
            lifecycle.draining = True
            timer = threading.Timer(settings.drain_s, super().handle_exit, (sig, None))
            timer.daemon = True
            timer.start()

        async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
            lifecycle.draining = lifecycle.ending = True
            await super().shutdown(sockets)

        async def startup(self, sockets: list[socket.socket] | None = None) -> None:
            await super().startup(sockets)
            with suppress(NotImplementedError, ValueError):  # no such signal, or not in the main thread
                asyncio.get_running_loop().add_signal_handler(signal.SIGHUP, self._reload)

        def _reload(self) -> None:
            self._reloading = asyncio.ensure_future(app.state.reload())
            self._reloading.add_done_callback(lambda task: task.exception())  # it is in the log

    Server(config).run()
