from __future__ import annotations

import asyncio
import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from boxlift.detector import DEFAULT_FILE
from boxlift.formats.calibration import parse_calibration
from boxlift.formats.kitti_label import parse_text
from boxlift.formats.prompts import parse_prompt_lists, parse_prompts
from boxlift.settings import PRESETS, LabellerSettings, RepairSettings
from boxlift_service.answers import DetectAnswer, LabelAnswer
from boxlift_service.app import create_app
from boxlift_service.detection.decoding import detect_fields
from boxlift_service.problems import ProblemDetails
from boxlift_service.settings import ServiceSettings
from service.running import RunningService

PATHS = {
    *("/label", "/label:batch", "/detect", "/pointCloud/recognition"),
    *("/healthz", "/readyz", "/metrics", "/models", "/models:reload"),
}


def test_probes_of_a_ready_service(service: RunningService) -> None:
    assert service.client.get("/healthz").json() == {"status": "alive"}
    assert service.client.get("/readyz").json() == {"status": "ready"}


def test_models_lists_the_presets(service: RunningService) -> None:
    answer = service.client.get("/models").json()
    assert answer["default_preset"] == "accurate"
    assert [labeller["preset"] for labeller in answer["labellers"]] == list(PRESETS)
    for labeller in answer["labellers"]:
        settings = LabellerSettings.model_validate(labeller["settings"])
        assert settings.fingerprint() == labeller["fingerprint"] == PRESETS[labeller["preset"]].fingerprint()


def test_models_lists_what_finds_objects_with_digests(service: RunningService, model_path: Path) -> None:
    answer = service.client.get("/models").json()
    assert answer["missing"] == {}
    assert answer["detector"]["name"] == "nanodet_g"
    assert answer["monocular"]["name"] == "hand_made"
    assert answer["monocular"]["classes"] == ["Car", "Pedestrian"]
    assert answer["monocular"]["metadata"]["licence"] == "Apache-2.0"
    for model, path in (("detector", DEFAULT_FILE), ("monocular", model_path)):
        assert answer[model]["digest"] == hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize(
    ("method", "path", "status"),
    [
        ("GET", "/nothing", 404),
        ("GET", "/label/", 404),
        ("GET", "/docs", 404),
        ("POST", "/%00%ff", 404),
        ("GET", "/label", 405),
        ("DELETE", "/healthz", 405),
    ],
)
def test_what_is_not_there_is_a_problem(service: RunningService, method: str, path: str, status: int) -> None:
    response = service.client.request(method, path)
    assert response.status_code == status
    assert response.headers["content-type"] == "application/problem+json"
    assert ProblemDetails.model_validate_json(response.content).status == status
    if status == 405:
        assert response.headers["allow"] in ("POST", "GET")


def test_request_id_is_echoed_or_made(service: RunningService) -> None:
    def answered(request_id: str) -> str:
        return service.client.get("/healthz", headers={"X-Request-ID": request_id}).headers["x-request-id"]

    assert answered("job-17/frame:3") == "job-17/frame:3"
    for unusable in ("", "has space", "x" * 129, '"quoted"'):
        assert answered(unusable) not in ("", unusable)
    assert service.client.get("/nothing", headers={"X-Request-ID": "n"}).headers["x-request-id"] == "n"


def in_process_get(path: str, settings: ServiceSettings | None = None) -> httpx.Response:
    """GET from an application whose server never started: no worker was started."""
    app = create_app(settings or ServiceSettings())

    @app.get("/fails")
    async def fails() -> None:
        raise RuntimeError("the secret inside")

    async def get() -> httpx.Response:
        async with httpx.AsyncClient(
            transport=httpx.ASGITransport(app), base_url="http://localhost"
        ) as client:
            return await client.get(path, headers={"X-Request-ID": "r1"})

    return asyncio.run(get())


def test_models_know_the_classes_of_the_priors_file(tmp_path: Path) -> None:
    path = tmp_path / "priors.toml"
    path.write_text('[Tram]\nheight_m = 3.6\nwidth_m = 2.4\nlength_m = 30\nsource = "x"\n')
    for labeller in in_process_get("/models", ServiceSettings(priors=path)).json()["labellers"]:
        assert labeller["settings"]["sizes"]["Tram"]["length_m"] == 30
        assert labeller["settings"]["sizes"]["Car"]["length_m"] == 4
        assert labeller["fingerprint"] != PRESETS[labeller["preset"]].fingerprint()


def test_a_failure_of_ours_is_a_problem_that_shows_nothing_inside() -> None:
    response = in_process_get("/fails")
    assert response.status_code == 500
    assert response.headers["content-type"] == "application/problem+json"
    assert response.headers["x-request-id"] == "r1"
    assert "secret" not in response.text
    assert "Traceback" not in response.text
    assert "r1" in response.json()["detail"]


def test_readyz_before_the_workers_are_open() -> None:
    response = in_process_get("/readyz")
    assert response.status_code == 503
    assert response.headers["retry-after"] == "2"
    assert "not started yet" in response.json()["problem"]


def references(value: Any) -> Iterator[str]:
    """Every $ref of a document."""
    if isinstance(value, dict):
        if isinstance(reference := value.get("$ref"), str):
            yield reference
        for member in value.values():
            yield from references(member)
    elif isinstance(value, list):
        for member in value:
            yield from references(member)


def test_openapi_describes_every_route_and_no_foreign_error(service: RunningService) -> None:
    text = service.client.get("/openapi.json").text
    document = json.loads(text)
    assert set(document["paths"]) == PATHS
    assert "HTTPValidationError" not in text
    for reference in references(document):
        node = document
        for key in reference.removeprefix("#/").split("/"):
            node = node[key]
    for path in document["paths"].values():
        for operation in path.values():
            for status, answer in operation["responses"].items():
                if int(status) >= 400:
                    problem = answer["content"]["application/problem+json"]
                    assert ProblemDetails.model_validate(problem["example"]).status == int(status)


def test_openapi_examples_are_genuine(service: RunningService) -> None:
    operation = service.client.get("/openapi.json").json()["paths"]["/label"]["post"]
    fields = operation["requestBody"]["content"]["multipart/form-data"]["schema"]["properties"]
    assert set(fields) == {"points", "calib", "prompts", "image", "masks", "options", "name"}
    for example in fields["calib"]["examples"]:
        parse_calibration(example)
    assert parse_prompts(fields["prompts"]["examples"][0])
    options = json.loads(fields["options"]["examples"][0])
    assert PRESETS[options.pop("preset")].with_options(options).repairs == RepairSettings(size="fixed")
    schema = fields["options"]["contentSchema"]["properties"]
    assert "grid_steps" in schema["fit"]["properties"]
    (size,) = schema["sizes"]["patternProperties"].values()
    assert "source" in size["required"]
    answers = operation["responses"]["200"]["content"]
    assert LabelAnswer.model_validate(answers["application/json"]["example"]).objects[0].category == "Car"
    assert parse_text(answers["text/plain"]["example"], "example")[0].score == 0.8714


def test_openapi_examples_of_detect_are_genuine(service: RunningService) -> None:
    operation = service.client.get("/openapi.json").json()["paths"]["/detect"]["post"]
    fields = operation["requestBody"]["content"]["multipart/form-data"]["schema"]["properties"]
    assert set(fields) == set(detect_fields(ServiceSettings()))
    assert fields["image"]["maxItems"] == 4
    for example in fields["calib"]["examples"]:
        parse_calibration(example[0], camera_only=True)
    one, two = fields["prompts"]["examples"]
    assert [len(prompts) for prompts in parse_prompt_lists(one, 1)] == [1]
    assert [len(prompts) for prompts in parse_prompt_lists(two, 2)] == [1, 0]
    answer = operation["responses"]["200"]["content"]["application/json"]["example"]
    assert DetectAnswer.model_validate(answer).images[0].objects[0].depth_spread == 0.041
