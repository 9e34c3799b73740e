"""JSON from strangers: strict about what JSON is, and every refusal an InputError."""

from __future__ import annotations

import json
import math
from collections import Counter
from typing import Any, NoReturn

from boxlift.errors import InputError
from boxlift.formats import archives


def parse_json(data: bytes | str, field: str, error_type: type[InputError]) -> Any:
    """JSON text (UTF-8) -> Python values. NaN, Infinity and repeated keys are refused.

    Raises `error_type` with `field` for anything that is not JSON.
    """

    def refuse_constant(name: str) -> NoReturn:
        raise error_type(field, f"the JSON holds {name}.", "Give finite numbers.")

    def unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) != len(pairs):
            repeated = [key for key, count in Counter(key for key, _ in pairs).items() if count > 1]
            raise error_type(
                field, f"the JSON repeats the keys {repeated[:5]!s:.120}.", "Give every key once."
            )
        return found

    archive = archives.archive_kind(data) if isinstance(data, bytes) else None
    if archive is not None:
        raise error_type(field, f"the data is {archive}.", archives.REMEDY)
    try:
        text = data if isinstance(data, str) else data.decode("utf-8-sig")
        return json.loads(text, parse_constant=refuse_constant, object_pairs_hook=unique_keys)
    except UnicodeDecodeError:
        raise error_type(field, "the data is not UTF-8 text.", "Give JSON.") from None
    except RecursionError:
        raise error_type(field, "the JSON is nested too deeply.", "Give the documented shape.") from None
    except ValueError as error:
        raise error_type(field, f"the data is not JSON ({error!s:.120}).", "Give valid JSON.") from None


def finite_number(value: object) -> float | None:
    """A JSON value as a finite float; None where it is none (true and "1" are none)."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None
