from __future__ import annotations

import json
import socket
from pathlib import Path

import pytest

from boxlift.datasets import load_prompts, open_source
from boxlift.errors import InputError
from boxlift.formats import details
from boxlift.frame import Prompt
from boxlift.labeller import Labeller
from boxlift.settings import PAPER, RELEASE, LabellerSettings
from boxlift_client.client import Client
from boxlift_client.errors import (
    RequestRefusedError,
    ServiceFailedError,
    ServiceUnreachableError,
    UnexpectedAnswerError,
)
from boxlift_client.label_answer import problem_error, read_label_answer


@pytest.fixture
def unused_url() -> str:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return f"http://127.0.0.1:{listener.getsockname()[1]}"


@pytest.mark.parametrize("settings", [PAPER, RELEASE, PAPER.with_options({"points": {"min_points": 60}})])
def test_a_frame_gets_the_labels_it_would_get_here(
    dataset: Path, service_url: str, settings: LabellerSettings
) -> None:
    source = open_source(dataset)
    frame = source.load(
        "000002", load_prompts("label_2", source, "000002"), masks=dataset / "training" / "masks"
    )
    with Client(service_url) as client:
        answer = client.label(frame, settings)
    here = details.details_of(Labeller(settings).label(frame))
    assert answer.details == here
    assert {item.result for item in here.objects} > {"FITTED"}  # refusals travel too
    assert answer.settings_fingerprint == settings.fingerprint()
    assert answer.kitti_text.count("\n") == sum(item.result == "FITTED" for item in here.objects)


def test_files_as_they_are(dataset: Path, service_url: str) -> None:
    split = dataset / "training"
    prompts = load_prompts("label_2", open_source(dataset), "000000")
    with Client(service_url) as client:
        by_path = client.label_files(
            split / "velodyne" / "000000.bin",
            split / "calib" / "000000.txt",
            prompts,
            image=split / "image_2" / "000000.png",
        )
        by_bytes = client.label_files(
            (split / "velodyne" / "000000.bin").read_bytes(),
            (split / "calib" / "000000.txt").read_bytes(),
            prompts,
            masks=split / "masks" / "000000.png",
            name="000000",
            options={"preset": "release"},
        )
        with pytest.raises(InputError, match=r"points: .*nowhere\.bin.* cannot be read"):
            client.label_files(Path("nowhere.bin"), b"", prompts)
    assert by_path.frame == by_bytes.frame == "000000"
    assert (by_path.preset, by_bytes.preset) == ("accurate", "release")
    assert len(by_path.objects) == len(by_bytes.objects) == len(prompts)
    assert by_path.objects != by_bytes.objects


def test_a_refusal_names_field_problem_and_remedy(service_url: str) -> None:
    with Client(service_url) as client, pytest.raises(RequestRefusedError) as refused:
        client.label_files(b"\0" * 15, b'{"P2": 1}', [Prompt("Car", (0, 0, 9, 9))])
    problem = refused.value.problem
    assert problem.status == 422
    assert problem.type.startswith("urn:boxlift:problem:")
    assert problem.field
    assert problem.problem
    assert problem.remedy
    assert problem.field in str(refused.value)
    assert service_url in str(refused.value)


def test_health(service_url: str, unused_url: str) -> None:
    with Client(f"{service_url}/") as client:
        assert client.health()
        assert client.ready()
        client.wait_until_ready()
    with Client(unused_url) as client:
        assert not client.health()
        assert not client.ready()
        with pytest.raises(ServiceUnreachableError, match="no boxlift service answers"):
            client.wait_until_ready(60)


@pytest.mark.parametrize("url", ["127.0.0.1:8000", "ftp://127.0.0.1", "http://[", "http://127.0.0.1:port"])
def test_what_is_no_url(url: str) -> None:
    with pytest.raises(ServiceUnreachableError), Client(url) as client:
        client.wait_until_ready()


def test_problems_become_exceptions() -> None:
    document = {"type": "urn:x", "title": "T", "status": 503, "detail": "Not yet.", "instance": "/label"}
    error = problem_error("http://x", 503, json.dumps(document).encode())
    assert isinstance(error, ServiceFailedError)
    assert error.problem.type == "urn:x"
    assert str(error) == "http://x: Not yet. (status 503)"
    for content in (b"<html>gateway</html>", b"[]", b"", b"\xff\xfe", b'{"detail": 3}'):
        assert isinstance(problem_error("http://x", 404, content), RequestRefusedError)


@pytest.mark.parametrize("content", [b"", b"{}", b"hello", b'{"frame": "a", "objects": [{}]}'])
def test_answers_of_other_programs(content: bytes) -> None:
    with pytest.raises(UnexpectedAnswerError, match="is not a label answer"):
        read_label_answer("http://x", content)
