from __future__ import annotations

import pytest

from boxlift_service.bodies.negotiation import negotiate
from boxlift_service.problems import Kind, ProblemError

JSON, TEXT = "application/json", "text/plain"


@pytest.mark.parametrize(
    ("accept", "answer"),
    [
        (None, JSON),
        ("", JSON),
        ("*/*", JSON),
        ("text/plain", TEXT),
        ("TEXT/Plain; charset=utf-8", TEXT),
        ("text/*", TEXT),
        ("application/json;q=0.2, text/plain;q=0.5", TEXT),
        ("application/json;q=0.5, text/plain;q=0.5", JSON),
        ("text/html, */*;q=0.1", JSON),
        ("text/plain;q=0, */*", JSON),
        ("application/json;q=0, */*", TEXT),
        ("*/*;q=0.9, application/*;q=0.1", TEXT),
        ("text/plain;q=nonsense, application/json;q=0.1", JSON),
        (",,;;, text/plain", TEXT),
    ],
)
def test_the_best_liked_type_is_chosen(accept: str | None, answer: str) -> None:
    assert negotiate(accept, (JSON, TEXT)) == answer


@pytest.mark.parametrize("accept", ["image/png", "application/json;q=0", "text/html;q=1", "nonsense"])
def test_nothing_acceptable(accept: str) -> None:
    with pytest.raises(ProblemError) as caught:
        negotiate(accept, (JSON, TEXT))
    assert caught.value.kind is Kind.NOT_ACCEPTABLE
