"""The monocular model behind LitServe: what benchmarks/peer.py compares the service with.

    python litserve_service.py PORT WORKERS THREADS

POST /predict takes the form of our POST /detect with one image. A worker of LitServe does with it what a
worker of ours does: parse the calibration, decode the PNG, run the network, decode the boxes, write the JSON.
LitServe parses the form, and sends it on to the worker as a pickle.
"""

# No annotations as text here: LitServe compares that of decode_request with the class.
import sys
from pathlib import Path
from typing import Any

import litserve  # type: ignore[import-not-found]
from fastapi import Request, Response

from boxlift.formats.calibration import parse_calibration
from boxlift.formats.image import decode_image
from boxlift.monocular import Monocular
from boxlift_service.answers import UsedModel, detect_answer_of


class MonocularApi(litserve.LitAPI):  # type: ignore[misc]
    """What LitServe calls in its workers."""

    def __init__(self, threads: int) -> None:
        super().__init__()
        self._threads = threads

    def setup(self, device: str) -> None:
        """Load the model that ships."""
        del device
        self._monocular = Monocular.open(None, self._threads)

    def decode_request(self, request: Request) -> tuple[str, Any, Any]:
        """Name, image and calibration of a form; LitServe sends the form where it says Request."""
        form: Any = request
        image = decode_image(form["image"].file.read())
        parsed = parse_calibration(_content(form["calib"]), camera_only=True)
        return Path(form["image"].filename).stem, image, parsed.calibration

    def predict(self, asked: tuple[str, Any, Any]) -> tuple[Any, tuple[int, int]]:
        """Labels and the size of the image."""
        name, image, calibration = asked
        return self._monocular.detect(name, image, calibration), (image.shape[1], image.shape[0])

    def encode_response(self, found: tuple[Any, tuple[int, int]]) -> Response:
        """The JSON of our own answer."""
        model = UsedModel(name=self._monocular.name, digest=self._monocular.digest)
        answer = detect_answer_of([found], model, None)
        return Response(answer.model_dump_json(by_alias=True), media_type="application/json")


def _content(field: Any) -> bytes:
    """Of a text field or of a file."""
    return field.encode() if isinstance(field, str) else bytes(field.file.read())


def main() -> None:
    """Serve until told to stop."""
    port, workers, threads = map(int, sys.argv[1:])
    server = litserve.LitServer(
        MonocularApi(threads), accelerator="cpu", workers_per_device=workers, timeout=False
    )
    server.run(host="127.0.0.1", port=port, generate_client_file=False, log_level="warning")


if __name__ == "__main__":
    main()
