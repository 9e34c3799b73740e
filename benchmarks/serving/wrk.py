"""wrk, where it is installed: a closed loop by somebody else's tool, with the same bytes."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

from serving.prepared import Prepared

# wrk asks for a request each time; these are drawn already.
_SCRIPT = """
local requests, turn = {}, 0
for index = 1, COUNT do
  local file = assert(io.open("FOLDER/" .. index, "rb"))
  requests[index] = file:read("*a")
  file:close()
end
request = function()
  turn = turn % COUNT + 1
  return requests[turn]
end
"""
_DRAWN = 60


def is_installed() -> bool:
    """Whether there is a wrk on this machine."""
    return shutil.which("wrk") is not None


def closed_loop(url: str, requests: Iterator[Prepared], connections: int, seconds: float) -> dict[str, Any]:
    """Answers a second, and how many were no success. Raises CalledProcessError where wrk fails."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for index, prepared in enumerate(islice(requests, _DRAWN), 1):
            (folder / str(index)).write_bytes(prepared.data)
        script = folder / "requests.lua"
        script.write_text(_SCRIPT.replace("COUNT", str(_DRAWN)).replace("FOLDER", name))
        command = ["wrk", "-t1", f"-c{connections}", f"-d{seconds:.0f}s", "--timeout", "60s"]
        ran = subprocess.run(
            [*command, "-s", str(script), url],
            capture_output=True,
            text=True,
            check=True,
            timeout=seconds + 90,
        )
    return {
        "per_second": _number(r"Requests/sec:\s+([\d.]+)", ran.stdout),
        "no_success": _number(r"Non-2xx or 3xx responses: (\d+)", ran.stdout),
        "socket_errors": sum(
            float(word) for word in re.findall(r"(?:connect|read|write|timeout) (\d+)", ran.stdout)
        ),
    }


def _number(pattern: str, text: str) -> float:
    found = re.search(pattern, text)
    return float(found[1]) if found else 0.0
