"""Every expression of dashboard and alerts, asked of a Prometheus that scrapes the service under load.

    python benchmarks/dashboard.py [--seconds 90] [--out panels.html] [--url URL --key KEY]

Needs the program `prometheus` (Debian's package of that name). Without --url it starts a service that asks
for keys, and kills a worker on the way; with it, alerts about what did not happen have no data. Ends with
status 1 where an expression gives none. The page shows the panels where the dashboard has them, drawn from
what Prometheus answered: Grafana itself is not needed.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import re
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx

from boxlift.settings import DEFAULT_PRESET, preset
from boxlift_client.detect_request import parts_of_image
from boxlift_client.label_request import form_of_frame
from boxlift_service.guards.api_keys import new_key
from serving import prepared, processes
from serving.panels import page
from serving.prometheus import DOCKER, STEP_S, Prometheus, Series, running_prometheus
from serving.service_process import Service, running_boxlift


def load(url: str, key: str, seconds: float, strike: Callable[[], None]) -> None:
    """Frames and images, among them what is refused, given up and wrong; half-way `strike`."""
    settings = preset(DEFAULT_PRESET)
    frames = prepared.frames(None, 3)
    end = time.monotonic() + seconds
    patience = {"X-Request-Timeout": "0.05"}

    def ask(thread: int) -> None:
        with httpx.Client(base_url=url, headers={"Authorization": f"Bearer {key}"}, timeout=60) as client:
            for turn, frame in enumerate(itertools.cycle(frames)):
                if time.monotonic() > end:
                    return
                assert frame.image is not None
                image = parts_of_image(frame.image, frame.calibration, None, None, frame.name)
                with suppress(httpx.TimeoutException, httpx.TransportError):
                    if turn % 9 == 8:
                        client.post("/detect", files=image, timeout=0.05)  # goes away
                    elif (turn + thread) % 3:
                        client.post(
                            "/label",
                            files=form_of_frame(frame, settings, detect=turn % 5 == 4),
                            headers=patience if turn % 11 == 10 else {},
                        )
                    else:
                        client.post("/detect", files=image)
                if turn % 15 == 14:
                    client.post("/label", files={"points": ("a.bin", b"")})
                    client.get("/nowhere")
                    httpx.get(f"{url}/models")

    threads = [threading.Thread(target=ask, args=(number,)) for number in range(6)]
    for thread in threads:
        thread.start()
    time.sleep(seconds / 2)
    strike()
    for thread in threads:
        thread.join()


def lose_a_request(service: Service, key: str) -> None:
    """Kill the label worker until a request is lost with it, and answered 500."""
    headers = {"Authorization": f"Bearer {key}"}
    for _ in range(1000):
        text = httpx.get(f"{service.url}/metrics", headers=headers).text
        if 'status="500"' in text:
            return
        if 'boxlift_running_requests{pool="label"} 1.0' in text:
            for pid in processes.workers(service.pid, processes.LABEL):
                os.kill(pid, signal.SIGKILL)
            time.sleep(1.5)
    raise RuntimeError("no request was lost.")


def panels_of(prometheus: Prometheus, begin: float, end: float) -> list[tuple[dict[str, Any], list[Series]]]:
    """The dashboard's panels, each with its data."""
    dashboard = json.loads((DOCKER / "grafana" / "dashboards" / "boxlift.json").read_text())
    return [
        (
            panel,
            [
                series
                for target in panel.get("targets", [])
                for series in prometheus.ask(target["expr"], begin, end, target["legendFormat"])
            ],
        )
        for panel in dashboard["panels"]
    ]


def judge(prometheus: Prometheus, begin: float, end: float) -> int:
    """Print how much data each expression gives; the number of those that give none."""
    missing = 0
    told = [
        (panel["title"], len(data)) for panel, data in panels_of(prometheus, begin, end) if "targets" in panel
    ]
    for rule in prometheus.rules():
        # Without what it is compared with: an alert gives data only while it is due.
        compared, *_ = re.split(r" (?:==|>|<) [\d.]+$", rule["query"])
        told.append(
            (f"{rule['name']} ({rule['health']}, {rule['state']})", len(prometheus.ask(compared, begin, end)))
        )
        missing += rule["health"] != "ok"
    for name, count in told:
        print(f"{count:4} series  {name}")
        missing += count == 0
    return missing


def main() -> int:
    """Run, judge, draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seconds", type=float, default=90.0)
    parser.add_argument("--out", type=Path, help="HTML page of the panels")
    parser.add_argument("--url", help="a service that runs already")
    parser.add_argument("--key", default="", help="and a key of it")
    given = parser.parse_args()
    if given.url:
        return _run(given.url, given.key, given.seconds, given.out, lambda: None)
    secret, key = new_key("dashboard")
    with tempfile.NamedTemporaryFile("w") as file:
        file.write(key.line)
        file.flush()
        # Few permits: something is refused.
        with running_boxlift({"api_keys": file.name, "permits_per_worker": "2"}) as service:
            return _run(
                service.url, secret, given.seconds, given.out, lambda: lose_a_request(service, secret)
            )


def _run(url: str, key: str, seconds: float, out: Path | None, strike: Callable[[], None]) -> int:
    with running_prometheus(url, key) as prometheus:
        begin = time.time()
        load(url, key, seconds, strike)
        time.sleep(3 * STEP_S)
        end = time.time()
        missing = judge(prometheus, begin, end)
        if out:
            out.write_text(page(panels_of(prometheus, begin, end), end - begin))
    print(f"{missing} expressions without data")
    return 1 if missing else 0


if __name__ == "__main__":
    sys.exit(main())
