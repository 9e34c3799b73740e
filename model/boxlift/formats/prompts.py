"""Prompts as JSON: a list of {"class": name, "box": [x1, y1, x2, y2] in pixels, "score": optional}.

Only what cannot be read is an error here. A box without area, one outside the image or an unknown class
is the labeller's to judge, prompt by prompt.
"""

from __future__ import annotations

import json
from collections.abc import Iterable

from boxlift.errors import PromptError, member
from boxlift.formats.json_text import finite_number, parse_json
from boxlift.frame import Prompt

# Masks number the prompts of a frame in 16 bits, and 0 is none.
MAX_PROMPTS = 65_535
_LONGEST_CLASS = 100
_KEYS = ("class", "box", "score")
_EXAMPLE = 'Give a list such as [{"class": "Car", "box": [100, 120, 180, 170], "score": 0.9}].'


def parse_prompts(data: bytes | str, field: str = "prompts") -> tuple[Prompt, ...]:
    """JSON -> prompts in its order; no score is 1. Raises PromptError that names index, key and value."""
    return _parse_list(parse_json(data, field, PromptError), field)


def parse_prompt_lists(
    data: bytes | str, count: int, field: str = "prompts"
) -> tuple[tuple[Prompt, ...], ...]:
    """JSON, a list of `count` lists -> prompts of that many images; of one image the list alone will do.

    Raises PromptError as parse_prompts does, and where there are more or fewer lists.
    """
    values = parse_json(data, field, PromptError)
    nested = isinstance(values, list) and bool(values) and all(isinstance(value, list) for value in values)
    if count == 1 and not nested:
        return (_parse_list(values, field),)
    if not nested or len(values) != count:
        given = f"{len(values)} lists" if nested else f"{values!r:.60}"
        raise PromptError(
            field,
            f"it holds {given} for {count} image{'s' if count > 1 else ''}.",
            "Give a list of lists, one per image, [] for none.",
        )
    return tuple(_parse_list(value, f"{field}[{index}]") for index, value in enumerate(values))


def to_json(prompts: Iterable[Prompt]) -> str:
    """Prompts -> JSON that parse_prompts reads."""
    return json.dumps(_values_of(prompts))


def lists_to_json(images: Iterable[Iterable[Prompt]]) -> str:
    """Prompts of several images -> JSON that parse_prompt_lists reads."""
    return json.dumps([_values_of(prompts) for prompts in images])


def _values_of(prompts: Iterable[Prompt]) -> list[dict[str, object]]:
    return [{"class": p.category, "box": list(p.box_px), "score": p.score} for p in prompts]


def _parse_list(values: object, field: str) -> tuple[Prompt, ...]:
    if not isinstance(values, list):
        raise PromptError(field, f"the JSON is no list ({values!r:.60}).", _EXAMPLE)
    if len(values) > MAX_PROMPTS:
        raise PromptError(field, f"there are {len(values)} prompts.", f"Give at most {MAX_PROMPTS} a frame.")
    return tuple(_parse_prompt(value, f"{field}[{index}]") for index, value in enumerate(values))


def _parse_prompt(value: object, where: str) -> Prompt:
    if not isinstance(value, dict):
        raise PromptError(where, f"{value!r:.60} is no object.", _EXAMPLE)
    for key in value:
        if key not in _KEYS:
            raise PromptError(member(where, key), f"the key {key!r:.40} is unknown.", f"Known keys: {_KEYS}.")
    for key in ("class", "box"):
        if key not in value:
            raise PromptError(f"{where}.{key}", f"the prompt has no {key!r}.", _EXAMPLE)
    category = value["class"]
    # Printable excludes line breaks and half surrogates (JSON's "\\ud800"), which no file could hold.
    if not (isinstance(category, str) and 0 < len(category) <= _LONGEST_CLASS and category.isprintable()):
        raise PromptError(
            f"{where}.class",
            f"{category!r:.60} is no class name.",
            f"Give 1 to {_LONGEST_CLASS} printable characters.",
        )
    return Prompt(category, _parse_box(value["box"], f"{where}.box"), _parse_score(value, f"{where}.score"))


def _parse_box(value: object, where: str) -> tuple[float, float, float, float]:
    edges = [finite_number(edge) for edge in value] if isinstance(value, list) else []
    numbers = [edge for edge in edges if edge is not None]
    if len(edges) != 4 or len(numbers) != 4:
        raise PromptError(
            where, f"{value!r:.80} is not four finite numbers.", "Give [x1, y1, x2, y2] in pixels."
        )
    x1, y1, x2, y2 = numbers
    return x1, y1, x2, y2


def _parse_score(prompt: dict[str, object], where: str) -> float:
    score = finite_number(prompt.get("score", 1.0))
    if score is None:
        raise PromptError(
            where, f"{prompt['score']!r:.60} is no finite number.", "Give a number or leave it out."
        )
    return score
