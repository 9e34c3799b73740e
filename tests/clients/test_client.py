from __future__ import annotations

import json
import socket
from pathlib import Path

import msgpack
import pytest

from boxlift.datasets import load_prompts, open_source
from boxlift.errors import InputError, OptionsError
from boxlift.formats import details
from boxlift.frame import Prompt
from boxlift.labeller import Labeller
from boxlift.settings import PAPER, RELEASE, LabellerSettings
from boxlift_client.client import Client
from boxlift_client.errors import (
    NotAuthorizedError,
    RequestRefusedError,
    ServiceBusyError,
    ServiceFailedError,
    ServiceUnreachableError,
    UnexpectedAnswerError,
)
from boxlift_client.label_answer import problem_error, read_label_answer
from boxlift_service.guards.api_keys import ApiKeys, add_key, new_key
from boxlift_service.guards.auth import AuthMiddleware
from boxlift_service.settings import ServiceSettings
from clients.scripted import Ask, Script, Scripted, label_answer, scripted, with_both_clients
from service.served import served

LABELLED = Scripted(content=json.dumps(label_answer()).encode())
PROBLEM = json.dumps({"type": "urn:x", "title": "T", "status": 429, "detail": "Later."}).encode()


def busy(status: int = 429, retry_after: str | None = "0") -> Scripted:
    headers = {} if retry_after is None else {"retry-after": retry_after}
    return Scripted(status, PROBLEM, headers)


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


def test_both_encodings_get_the_same_labels(dataset: Path, service_url: str) -> None:
    source = open_source(dataset)
    frame = source.load("000000", load_prompts("label_2", source, "000000"))
    with Client(service_url) as client, Client(service_url, encoding="multipart") as by_form:
        assert client.label(frame, RELEASE) == by_form.label(frame, RELEASE)


def test_an_encoding_is_what_is_sent() -> None:
    with scripted(LABELLED) as script, Client(script.url) as client:
        client.label_files(b"points", b"calib", name="a")
        with Client(script.url, encoding="multipart") as by_form:
            by_form.label_files(b"points", b"calib", name="a")
    packed, form = script.asked
    assert (packed.path, packed.headers["content-type"]) == ("/label", "application/msgpack")
    fields = {"name": b"a", "points": b"points", "calib": b"calib", "points_filename": "points"}
    assert msgpack.unpackb(packed.body) == fields
    assert form.headers["content-type"].startswith("multipart/form-data; boundary=")


@with_both_clients
def test_the_key_and_the_timeout_are_sent(ask: Ask, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("BOXLIFT_API_KEY", raising=False)
    with scripted(LABELLED) as script:
        ask(script.url, "label_files", b"", b"")
        monkeypatch.setenv("BOXLIFT_API_KEY", "from-environment")
        ask(script.url, "label_files", b"", b"")
        ask(script.url, "label_files", b"", b"", client={"api_key": "given", "timeout_s": 7.5})
        ask(script.url, "health", client={"api_key": ""})
    keys = [asked.headers.get("authorization") for asked in script.asked]
    assert keys == [None, "Bearer from-environment", "Bearer given", None]
    assert [asked.headers["x-request-timeout"] for asked in script.asked] == ["120", "120", "7.5", "120"]


def test_what_is_no_key_is_not_shown() -> None:
    with pytest.raises(OptionsError, match="BOXLIFT_API_KEY") as refused:
        Client("http://127.0.0.1:9", api_key="secret\n")
    assert "secret" not in str(refused.value)


@with_both_clients
def test_a_service_that_asks_for_keys(ask: Ask, tmp_path: Path) -> None:
    secret, key = new_key("studio")
    add_key(tmp_path / "keys", key)
    settings = ServiceSettings(api_keys=tmp_path / "keys")
    app = AuthMiddleware(Script("", [LABELLED]), ApiKeys(tmp_path / "keys"), settings, lambda _: None)
    with served(app) as server:
        assert ask(server.url, "label_files", b"", b"", client={"api_key": secret}).frame == "a"
        for wrong in ("", "boxlift_wrong"):
            with pytest.raises(NotAuthorizedError) as refused:
                ask(server.url, "label_files", b"", b"", client={"api_key": wrong})
            assert refused.value.problem.status == 401


@with_both_clients
def test_a_busy_service_is_asked_again(ask: Ask) -> None:
    with scripted(busy(), busy(503), LABELLED) as script:
        assert ask(script.url, "label_files", b"", b"").frame == "a"
    assert len(script.asked) == 3
    assert script.asked[0].body == script.asked[2].body


@pytest.mark.parametrize(
    ("refusal", "patience_s", "error_type"),
    [
        (busy(), 0, ServiceBusyError),
        (busy(retry_after="3600"), 60, ServiceBusyError),
        (busy(retry_after=None), 60, ServiceBusyError),
        (busy(retry_after="Wed, 21 Oct 2026 07:28:00 GMT"), 60, ServiceBusyError),
        (busy(503, retry_after=None), 60, ServiceFailedError),
        (busy(500), 60, ServiceFailedError),
        (busy(408), 60, RequestRefusedError),
    ],
)
@with_both_clients
def test_patience_has_bounds(
    ask: Ask, refusal: Scripted, patience_s: float, error_type: type[Exception]
) -> None:
    with scripted(refusal) as script, pytest.raises(error_type, match=r"Later\. \(status"):
        ask(script.url, "label_files", b"", b"", client={"patience_s": patience_s})
    assert len(script.asked) == 1


@with_both_clients
def test_a_connection_that_breaks_is_made_again_once(ask: Ask) -> None:
    cut = Scripted(content=b"{", is_cut=True)
    with scripted(cut, LABELLED) as script:
        assert ask(script.url, "label_files", b"", b"").frame == "a"
    with scripted(cut) as script:
        with pytest.raises(ServiceUnreachableError):
            ask(script.url, "label_files", b"", b"")
        assert len(script.asked) == 2


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
