"""Exit status 0 while the service of this container answers frames, as its /readyz says; else 1."""

import http.client
import os
import sys

try:
    connection = http.client.HTTPConnection(
        "127.0.0.1", int(os.environ.get("BOXLIFT_PORT", "8000")), timeout=4
    )
    connection.request("GET", "/readyz")
    answer = connection.getresponse()
except (OSError, http.client.HTTPException) as error:
    sys.exit(f"no answer: {error}")
if answer.status != 200:
    sys.exit(f"{answer.status}: {answer.read(1000).decode(errors='replace')}")
