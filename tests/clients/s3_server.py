"""An S3-compatible server in a process and on a port of its own: moto's, which keeps buckets in memory.

It is no storage product; but it speaks S3 over HTTP with the real client library (s3fs, botocore), and counts
what is asked of it.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

BUCKET = "fleet"


@contextmanager
def running_s3(log: Path) -> Iterator[str]:
    """A server with one empty bucket; its URL. `log`: where it writes a line for every request."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    url = f"http://127.0.0.1:{port}"
    command = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)]
    with log.open("w") as file, subprocess.Popen(command, stdout=file, stderr=file) as server:
        try:
            _await(url, server)
            before = dict(os.environ)
            os.environ.update(
                AWS_ACCESS_KEY_ID="key",
                AWS_SECRET_ACCESS_KEY="secret",
                AWS_DEFAULT_REGION="us-east-1",
                AWS_ENDPOINT_URL=url,
            )
            urllib.request.urlopen(urllib.request.Request(f"{url}/{BUCKET}", method="PUT")).close()
            yield url
        finally:
            server.terminate()
            for name in set(os.environ) - set(before):
                del os.environ[name]
            os.environ.update(before)


def _await(url: str, server: subprocess.Popen[bytes]) -> None:
    for _ in range(600):
        assert server.poll() is None, "moto's server ended"
        try:
            urllib.request.urlopen(f"{url}/moto-api/").close()
        except urllib.error.URLError:
            time.sleep(0.05)
        else:
            return
    raise TimeoutError("moto's server does not answer")
