from __future__ import annotations

import sqlite3
import threading
from collections.abc import Iterator
from pathlib import Path
from uuid import uuid4

import pytest
from pydantic import ValidationError

from boxlift.corrections.correction import Correction, CorrectionConflictError, Opinion, Verdict
from boxlift.corrections.store import FILE_NAME, CorrectionStore, default_url
from boxlift.errors import OptionsError
from boxlift.formats.details import BoxDetails

BOX = BoxDetails(center_cam=(1.0, 1.5, 20.0), length_m=4.0, width_m=1.8, height_m=1.6, rotation_y=0.3)
ACCEPTED, REJECTED = Opinion(verdict=Verdict.ACCEPTED), Opinion(verdict=Verdict.REJECTED)
CORRECTED = Opinion(verdict=Verdict.CORRECTED, box=BOX, category="Van")


@pytest.fixture
def label_set() -> str:
    """A name that no other test has in the same database."""
    return f"labels-{uuid4()}"


@pytest.fixture
def store(store_url: str, label_set: str) -> Iterator[CorrectionStore]:
    opened = CorrectionStore(store_url, label_set)
    yield opened
    opened.close()


def say(
    store: CorrectionStore, opinion: Opinion, based_on: int = 0, author: str = "ann", request: str = ""
) -> Correction:
    request_id = request or f"{author}-{based_on}-{opinion.verdict}"
    return store.add("000001", 2, opinion, based_on=based_on, author=author, request_id=request_id)


def test_what_was_said_last_holds_and_all_of_it_is_kept(store: CorrectionStore) -> None:
    first = say(store, CORRECTED)
    second = say(store, REJECTED, based_on=1, author="bob")
    assert store.latest() == [second]
    assert store.history() == [first, second]
    assert (first.opinion, first.author, first.revision) == (CORRECTED, "ann", 1)
    assert first.made_at.tzinfo is not None
    assert store.latest("000002") == []
    assert store.latest(since=second.sequence) == []


@pytest.mark.parametrize("based_on", [0, 2])
def test_an_opinion_on_another_revision_than_the_latest_is_refused(
    store: CorrectionStore, based_on: int
) -> None:
    kept = say(store, ACCEPTED)
    with pytest.raises(CorrectionConflictError) as refused:
        say(store, REJECTED, based_on=based_on, author="bob")
    assert refused.value.latest == kept
    assert "ann" in str(refused.value)
    assert store.history() == [kept]


def test_the_same_request_counts_once(store: CorrectionStore) -> None:
    kept = say(store, ACCEPTED, request="request-1")
    assert say(store, ACCEPTED, request="request-1") == kept
    assert store.history() == [kept]


def test_of_many_who_speak_at_once_one_is_first(store_url: str, label_set: str) -> None:
    """Each with a connection of its own, as several services have."""
    stores = [CorrectionStore(store_url, label_set) for _ in range(6)]
    kept: list[Correction] = []
    refused: list[CorrectionConflictError] = []
    together = threading.Barrier(len(stores))

    def speak(number: int) -> None:
        together.wait()
        try:
            kept.append(say(stores[number], ACCEPTED, author=f"person-{number}"))
        except CorrectionConflictError as error:
            refused.append(error)

    threads = [threading.Thread(target=speak, args=(number,)) for number in range(len(stores))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(kept) == 1
    assert [each.latest for each in refused] == kept * 5
    for each in stores:
        each.close()


def test_label_sets_in_one_database_know_nothing_of_each_other(store_url: str, label_set: str) -> None:
    one, other = (CorrectionStore(store_url, f"{label_set}{name}") for name in ("one", "other"))
    say(one, ACCEPTED)
    assert other.latest() == []
    assert say(other, REJECTED).revision == 1
    one.close()
    other.close()


def test_the_file_has_a_log_that_outlives_a_kill(tmp_path: Path) -> None:
    store = CorrectionStore(default_url(tmp_path), "labels")
    say(store, ACCEPTED)
    with sqlite3.connect(tmp_path / FILE_NAME) as connection:
        assert connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)
        assert connection.execute("SELECT count(*) FROM boxlift_corrections").fetchone() == (1,)
    connection.close()
    store.close()


@pytest.mark.parametrize("url", ["nonsense", "nosuch://host/name", "sqlite:////nowhere/at/all.sqlite"])
def test_a_database_that_cannot_be_opened_is_named_by_the_setting(url: str) -> None:
    with pytest.raises(OptionsError, match="corrections: the database cannot be opened"):
        CorrectionStore(url, "labels")


def test_a_file_that_is_no_database_is_named_by_the_setting(tmp_path: Path) -> None:
    (tmp_path / FILE_NAME).write_bytes(b"This was a database once." * 100)
    with pytest.raises(OptionsError, match="file is not a database"):
        CorrectionStore(default_url(tmp_path), "labels")


@pytest.mark.parametrize(
    "opinion",
    [
        {"verdict": "corrected"},
        {"verdict": "corrected", "box": BOX.model_dump()},
        {"verdict": "accepted", "box": BOX.model_dump(), "category": "Car"},
        {"verdict": "corrected", "box": {**BOX.model_dump(), "length_m": -1}, "category": "Car"},
        {"verdict": "corrected", "box": {**BOX.model_dump(), "length_m": "nan"}, "category": "Car"},
        {"verdict": "corrected", "box": BOX.model_dump(), "category": "two words"},
        {"verdict": "liked"},
    ],
)
def test_opinions_that_make_no_sense_are_refused(opinion: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        Opinion.model_validate(opinion)
