from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import msgpack
import pytest

from boxlift.datasets import load_prompts, open_source
from boxlift.errors import ImageError, InputError
from boxlift.frame import Frame
from boxlift.settings import RELEASE
from boxlift_client.batch import FrameGroups, FrameOutcome, Item, PackedFrame
from boxlift_client.client import Client
from boxlift_client.errors import RequestRefusedError, ServiceBusyError, UnexpectedAnswerError
from boxlift_client.label_request import FrameFiles
from clients.scripted import Ask, Scripted, label_answer, lines, scripted, with_both_clients

NAMES = ["000000", "000001", "000002"]
END = {"frames": 1, "labelled": 1, "failed": 0, "complete": True}
BUSY = {"type": "urn:boxlift:problem:too-busy", "title": "T", "status": 429, "detail": "No room."}


def done(index: int, name: str) -> dict[str, object]:
    return {"frame": name, "index": index, "status": 200, "answer": label_answer(name)}


def files(name: str) -> FrameFiles:
    return FrameFiles(points=b"0", calib=b"0", name=name)


@pytest.fixture(scope="module")
def frames(dataset: Path) -> list[Frame]:
    source = open_source(dataset)
    masks = dataset / "training" / "masks"
    return [source.load(name, load_prompts("label_2", source, name), masks=masks) for name in NAMES]


@with_both_clients
def test_frames_of_a_batch_get_the_labels_they_get_alone(
    ask: Ask, frames: list[Frame], service_url: str
) -> None:
    outcomes: list[FrameOutcome] = ask(service_url, "label_batch", iter(frames), RELEASE)
    assert sorted((outcome.index, outcome.name) for outcome in outcomes) == list(enumerate(NAMES))
    with Client(service_url) as client:
        for outcome in outcomes:
            assert outcome.answer == client.label(frames[outcome.index], RELEASE)


@with_both_clients
def test_a_frame_at_fault_costs_no_other(
    ask: Ask, frames: list[Frame], dataset: Path, service_url: str
) -> None:
    split = dataset / "training"
    points, calib = split / "velodyne" / "000001.bin", split / "calib" / "000001.txt"
    prompts, image = frames[1].prompts, split / "image_2" / "000001.png"
    given = [
        frames[0],
        FrameFiles(split / "velodyne" / "nowhere.bin", calib, prompts),
        FrameFiles(points, calib, prompts, image=image),
        FrameFiles(points, calib, [], image=image),  # the same name again
        FrameFiles(b"\0" * 17, calib, prompts, image=image, name="cut"),
    ]
    outcomes = {item.index: item for item in ask(service_url, "label_batch", given)}
    assert [outcomes[index].name for index in range(5)] == ["000000", "nowhere", "000001", "000001", "cut"]
    assert [outcomes[index].error is None for index in range(5)] == [True, False, True, True, False]
    assert isinstance(outcomes[1].error, InputError)
    assert "nowhere.bin' cannot be read" in str(outcomes[1].error)
    refused = outcomes[4].error
    assert isinstance(refused, RequestRefusedError)
    assert (refused.problem.status, refused.problem.field) == (422, "points")
    assert outcomes[2].answer is not None
    assert outcomes[2].answer.frame == "000001"
    assert len(outcomes[2].answer.objects) == len(prompts)


@with_both_clients
def test_objects_are_found_by_the_service(ask: Ask, dataset: Path, service_url: str) -> None:
    frame = open_source(dataset).load("000001", with_image=True)
    blind = replace(frame, image=None, name="blind")
    outcomes = ask(service_url, "label_batch", [frame, blind], RELEASE, detect=True)
    found, failed = sorted(outcomes, key=lambda outcome: outcome.index)
    with Client(service_url) as client:
        assert found.answer == client.label(frame, RELEASE, detect=True)
    assert isinstance(failed.error, ImageError)


def test_frames_are_taken_as_they_are_needed(service_url: str, frames: list[Frame]) -> None:
    taken = 0

    def endless() -> Iterator[Frame]:
        nonlocal taken
        while True:
            yield replace(frames[0], name=str(taken), prompts=())
            taken += 1

    with Client(service_url) as client:
        outcomes = islice(client.label_batch(endless(), RELEASE), 20)
        assert [outcome.error for outcome in outcomes] == [None] * 20
    assert taken < 200


@with_both_clients
def test_what_the_service_did_not_come_to_is_sent_again(ask: Ask) -> None:
    cut = Scripted(content=lines(done(0, "a")), is_cut=True)
    half = Scripted(content=lines(done(1, "b"), {**END, "complete": False}))
    rest = Scripted(content=lines(done(1, "c"), done(0, "a"), {**END, "frames": 2}))
    with scripted(cut, half, rest) as script:
        outcomes = ask(script.url, "label_batch", [files("a"), files("b"), files("c")])
    assert [(outcome.index, outcome.name) for outcome in outcomes] == [(1, "b"), (2, "c"), (0, "a")]
    assert all(outcome.answer.frame == outcome.name for outcome in outcomes)
    assert [_names(asked.body) for asked in script.asked] == [["a", "b", "c"]] * 2 + [["a", "c"]]
    assert {asked.headers["content-type"] for asked in script.asked} == {"application/msgpack"}


@with_both_clients
def test_a_frame_that_there_was_no_room_for_is_sent_again(ask: Ask) -> None:
    busy = {"frame": "a", "index": 0, "status": 429, "problem": BUSY}
    no_room = Scripted(content=lines(busy, done(1, "b"), END))
    with scripted(no_room, Scripted(content=lines(done(0, "a"), END))) as script:
        outcomes = ask(script.url, "label_batch", [files("a"), files("b")])
    assert [(outcome.name, outcome.error) for outcome in outcomes] == [("b", None), ("a", None)]
    with scripted(no_room) as script:
        impatient = ask(script.url, "label_batch", [files("a"), files("b")], client={"patience_s": 0})
    assert [type(outcome.error) for outcome in impatient] == [ServiceBusyError, type(None)]
    assert len(script.asked) == 1


ANSWERS = {
    "no last line": lines(done(0, "a")),
    "another frame": lines(done(1, "b"), END),
    "negative": lines(done(-1, "b"), END),
    "not boxlift": b"<html>",
    "nothing": b"",
    "frame left out": lines({**END, "complete": False}),
}


@with_both_clients
@pytest.mark.parametrize("content", ANSWERS.values(), ids=ANSWERS)
def test_answers_of_other_programs(ask: Ask, content: bytes) -> None:
    with scripted(Scripted(content=content)) as script, pytest.raises(UnexpectedAnswerError):
        ask(script.url, "label_batch", [files("a")], client={"patience_s": 0})


@with_both_clients
def test_labels_of_other_settings_are_no_answer(ask: Ask, frames: list[Frame]) -> None:
    with (
        scripted(Scripted(content=lines(done(0, "000000"), END))) as script,
        pytest.raises(UnexpectedAnswerError, match="labelled with the settings 0, not with"),
    ):
        ask(script.url, "label_batch", frames[:1])


@with_both_clients
def test_what_is_no_frames_fault_ends_the_batch(ask: Ask) -> None:
    problem = Scripted(status=401, content=json.dumps({"detail": "No key."}).encode())
    with scripted(problem) as script, pytest.raises(RequestRefusedError, match="No key"):
        ask(script.url, "label_batch", [files(str(index)) for index in range(100)])


@with_both_clients
def test_no_frames_are_no_request(ask: Ask) -> None:
    unread = FrameFiles(Path("nowhere.bin"), b"")
    with scripted(Scripted(status=500)) as script:
        assert ask(script.url, "label_batch", []) == []
        (outcome,) = ask(script.url, "label_batch", [unread])
    assert isinstance(outcome.error, InputError)
    assert script.asked == []


def test_groups_are_bounded_and_have_no_name_twice() -> None:
    def grouped(*items: Item) -> list[list[str]]:
        groups = FrameGroups()
        full = [group for item in items for group in groups.add(item)]
        return [[item.name for item in group] for group in full + groups.rest()]

    def frame(name: str, size: int = 1) -> PackedFrame:
        return PackedFrame(0, name, bytes(size))

    many = [str(number) for number in range(40)]
    assert grouped(*map(frame, many)) == [many[:16], many[16:32], many[32:]]
    assert grouped(frame("a"), frame("b"), frame("a"), frame("c")) == [["a", "b"], ["a", "c"]]
    large = 12 * 2**20
    assert grouped(frame("a", large), frame("b", large), frame("c", 9)) == [["a"], ["b", "c"]]
    assert grouped(frame("a", 3 * large), frame("b", 9)) == [["a"], ["b"]]
    assert grouped(FrameOutcome(0, "a"), frame("b")) == [["a", "b"]]
    assert grouped() == []


def _names(body: bytes) -> list[str]:
    unpacker = msgpack.Unpacker()
    unpacker.feed(body)
    return [frame["name"].decode() for frame in unpacker]
