"""Prompts as JSON."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from boxlift import Prompt
from boxlift.errors import PromptError
from boxlift.formats.prompts import lists_to_json, parse_prompt_lists, parse_prompts, to_json

ONE = '{"class": "Car", "box": [1, 2.5, 30, 40]}'


def test_prompts_in_order() -> None:
    prompts = parse_prompts(f'[{ONE}, {{"class": "Cyclist", "box": [5, 6, 7, 8], "score": 0.25}}]'.encode())
    assert prompts == (Prompt("Car", (1, 2.5, 30, 40), 1.0), Prompt("Cyclist", (5, 6, 7, 8), 0.25))


@pytest.mark.parametrize(
    "box", ["[9, 9, 9, 9]", "[30, 40, 1, 2]", "[-900, -900, -800, -800]", "[1e6, 0, 2e6, 1]"]
)
def test_boxes_that_cannot_be_used_are_for_the_labeller_to_judge(box: str) -> None:
    assert len(parse_prompts(f'[{{"class": "Nobody", "box": {box}}}]')) == 1


def test_no_prompts() -> None:
    assert parse_prompts("[]") == ()


@given(
    st.lists(
        st.builds(
            Prompt,
            st.text(st.characters(exclude_categories=("C", "Z")), min_size=1, max_size=100),
            st.tuples(*[st.floats(allow_nan=False, allow_infinity=False)] * 4),
            st.floats(allow_nan=False, allow_infinity=False),
        ),
        max_size=4,
    )
)
def test_round_trip(prompts: list[Prompt]) -> None:
    assert parse_prompts(to_json(prompts)) == tuple(prompts)


@pytest.mark.parametrize(
    ("text", "field", "says"),
    [
        ("", "prompts", "not JSON"),
        ("{}", "prompts", "no list"),
        ("null", "prompts", "no list"),
        ("[" * 100_000, "prompts", "nested"),
        ("[" + "1" * 5000 + "]", "prompts", "not JSON"),
        (f"[{ONE}, 3]", "prompts[1]", "3 is no object"),
        ('[{"box": [1, 2, 3, 4]}]', "prompts[0].class", "no 'class'"),
        ('[{"class": "Car"}]', "prompts[0].box", "no 'box'"),
        (f'[{ONE}, {ONE}, {{"class": "Car", "box": [1, 2, "x", 4]}}]', "prompts[2].box", "'x'"),
        ('[{"class": "Car", "box": [1, 2, 3]}]', "prompts[0].box", "[1, 2, 3]"),
        ('[{"class": "Car", "box": {"x1": 1}}]', "prompts[0].box", "x1"),
        ('[{"class": "Car", "box": [1, 2, 3, null]}]', "prompts[0].box", "None"),
        ('[{"class": "Car", "box": [1, 2, 3, NaN]}]', "prompts", "NaN"),
        ('[{"class": "Car", "box": [1, 2, 3, 1e999]}]', "prompts[0].box", "inf"),
        ('[{"class": 7, "box": [1, 2, 3, 4]}]', "prompts[0].class", "7"),
        ('[{"class": "", "box": [1, 2, 3, 4]}]', "prompts[0].class", "''"),
        ('[{"class": "Car\\n", "box": [1, 2, 3, 4]}]', "prompts[0].class", r"'Car\n'"),
        (r'[{"class": "\ud800", "box": [1, 2, 3, 4]}]', "prompts[0].class", r"'\ud800'"),
        ('[{"class": "%s", "box": [1, 2, 3, 4]}]' % ("x" * 101), "prompts[0].class", "xxx"),
        ('[{"class": "Car", "box": [1, 2, 3, 4], "score": "high"}]', "prompts[0].score", "'high'"),
        ('[{"class": "Car", "box": [1, 2, 3, 4], "score": null}]', "prompts[0].score", "None"),
        ('[{"class": "Car", "box": [1, 2, 3, 4], "mask": 1}]', "prompts[0].mask", "unknown"),
        ('[{"class": "Car", "class": "Van", "box": [1, 2, 3, 4]}]', "prompts", "['class']"),
        ("[" + ",".join([ONE] * 65_536) + "]", "prompts", "65536"),
    ],
)  # fmt: skip
def test_refusals(text: str, field: str, says: str) -> None:
    with pytest.raises(PromptError) as caught:
        parse_prompts(text)
    assert caught.value.field == field
    assert says in caught.value.problem
    assert caught.value.remedy


def test_bytes_that_are_no_text() -> None:
    with pytest.raises(PromptError, match="UTF-8"):
        parse_prompts(b"\xff[]")


def test_prompts_of_several_images() -> None:
    prompts = (Prompt("Car", (1.0, 2.0, 3.5, 4.0), 0.5), Prompt("Van", (0.0, 0.0, 9.0, 9.0)))
    for images in ([prompts, (), prompts[:1]], [()], [prompts]):
        text = lists_to_json(images)
        assert list(parse_prompt_lists(text, len(images))) == [tuple(image) for image in images]
    assert parse_prompt_lists(to_json(prompts), 1) == (prompts,)
    assert parse_prompt_lists("[]", 1) == ((),)
    for text, count in (("[]", 2), ("[[]]", 2), ("[[], {}]", 2), ("{}", 1), ("[[], []]", 1), ("3", 3)):
        with pytest.raises(PromptError):
            parse_prompt_lists(text, count)
