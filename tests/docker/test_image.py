"""The Dockerfile and what goes into the image beside the packages."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from fnmatch import fnmatch
from http.server import BaseHTTPRequestHandler, HTTPServer
from threading import Thread

import pytest

from boxlift.errors import OptionsError
from boxlift_service.guards.auth import check_exposure
from docker.files import DOCKER, ROOT, dockerfile, image_environment, last_stage, settings_in


def _words(instruction: str) -> list[list[str]]:
    return [line.split()[1:] for line in last_stage() if line.startswith(f"{instruction} ")]


def test_what_is_copied_exists_and_is_not_ignored() -> None:
    ignore = (DOCKER / "Dockerfile.dockerignore").read_text().split("\n")
    let_through = [line[1:] for line in ignore if line.startswith("!")]
    copied = {
        source
        for line in dockerfile()
        if line.startswith("COPY ") and "--from=" not in line
        for source in line.split()[1:-1]
    }
    assert copied
    for source in sorted(copied):
        assert (ROOT / source).exists(), source
        assert any(fnmatch(source, pattern) for pattern in let_through), f"{source} is ignored"


def test_stages_that_are_copied_from_exist() -> None:
    stages = {line.split()[3] for line in dockerfile() if re.match(r"FROM \S+ AS ", line)}
    copied_from = set(re.findall(r"--from=(\S+)", "\n".join(dockerfile())))
    assert copied_from <= stages


def test_runs_as_a_numbered_user_that_is_not_root() -> None:
    ((user,),) = _words("USER")
    uid, gid = user.split(":")
    assert int(uid) > 0
    assert int(gid) > 0


def test_installs_what_open3d_links_against() -> None:
    script = (DOCKER / "system-libraries.sh").read_text()
    needed = set(re.findall(r"has_library \S+ \|\| need (\S+)", script))
    assert len(needed) == 5
    run = " ".join(line for line in last_stage() if line.startswith("RUN ")).split()
    assert needed <= set(run)


def test_keeps_the_number_of_the_package() -> None:
    (version,) = re.findall(r"ARG VERSION=(\S+)", "\n".join(last_stage()))
    assert f'__version__ = "{version}"' in (ROOT / "model" / "boxlift" / "__init__.py").read_text()


def test_writes_nowhere_but_to_tmp_and_sends_nothing() -> None:
    environment = image_environment()
    assert environment["HOME"] == "/tmp"
    assert environment["ORT_DISABLE_TELEMETRY"] == "1"
    assert environment["PYTHONDONTWRITEBYTECODE"] == "1"
    assert _words("WORKDIR") == [["/tmp"]]


def test_asks_for_keys_before_it_listens() -> None:
    settings = settings_in({})
    assert settings.host == "0.0.0.0"
    with pytest.raises(OptionsError, match="BOXLIFT_API_KEYS"):
        check_exposure(settings)
    check_exposure(settings_in({"BOXLIFT_ALLOW_ANONYMOUS": "true"}))


@contextmanager
def _answering(status: int) -> Iterator[int]:
    """A server on a port of its own, from the asking on, that answers /readyz with `status`."""

    class Answer(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(status if self.path == "/readyz" else 404)
            self.end_headers()
            self.wfile.write(b"the sentence")

        def log_message(self, *_: object) -> None:
            pass

    with HTTPServer(("127.0.0.1", 0), Answer) as server:
        thread = Thread(target=server.serve_forever)
        thread.start()
        try:
            yield server.server_port
        finally:
            server.shutdown()
            thread.join()


def _check_health(port: int) -> subprocess.CompletedProcess[str]:
    # A proxy is for what lies outside, not for oneself.
    environment = {**os.environ, "BOXLIFT_PORT": str(port), "http_proxy": "http://127.0.0.1:9"}
    return subprocess.run(
        [sys.executable, DOCKER / "healthcheck.py"],
        env=environment,
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )


def test_health_check_passes_while_ready() -> None:
    with _answering(200) as port:
        assert _check_health(port).returncode == 0


def test_health_check_fails_with_the_sentence_while_not_ready() -> None:
    with _answering(503) as port:
        result = _check_health(port)
    assert result.returncode == 1
    assert "503: the sentence" in result.stderr


def test_health_check_fails_where_nobody_listens() -> None:
    with _answering(200) as port:
        pass
    result = _check_health(port)
    assert result.returncode == 1
    assert "no answer" in result.stderr
    assert "Traceback" not in result.stderr


def test_health_check_is_what_the_image_runs() -> None:
    (health,) = [line for line in last_stage() if line.startswith("HEALTHCHECK ")]
    assert '"/opt/boxlift/healthcheck.py"' in health
    assert "COPY docker/healthcheck.py /opt/boxlift/" in dockerfile()
