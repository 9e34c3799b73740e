"""A user's size priors as TOML: one table per class.

    [Tram]
    height_m = 3.6
    width_m = 2.4
    length_m = 30.0
    source = "Operator's data sheet"

A class that is built in may be given anew. [[Car.templates]] adds common sizes, each with a `name`.
"""

from __future__ import annotations

import tomllib
from functools import reduce
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from boxlift.errors import OptionsError, member
from boxlift.priors import ClassName, SizePrior

_SIZES = TypeAdapter(dict[ClassName, SizePrior])
_REMEDY = "Give a table per class, e.g. [Tram], with height_m, width_m and length_m in metres and a source."


def parse_size_priors(text: str, field: str = "priors") -> dict[str, SizePrior]:
    """TOML -> the sizes it declares, the built-in ones not among them.

    `field` is what errors call the file. Raises OptionsError that names class, key and value.
    """
    try:
        return _SIZES.validate_python(tomllib.loads(text))
    except ValidationError as error:
        first = error.errors()[0]
        # Pydantic ends the place of a wrong key with "[key]".
        place = (str(part) for part in first["loc"] if part != "[key]")
        where = reduce(member, place, field)
        if first["type"] == "missing":
            raise OptionsError(where, "it is missing.", _REMEDY) from None
        raise OptionsError(where, f"{first['msg']} (got {first['input']!r:.80}).", _REMEDY) from None
    except RecursionError:
        raise OptionsError(field, "the TOML is nested too deeply.", _REMEDY) from None
    # TOMLDecodeError, and what int() says of thousands of digits. Pydantic's error is a ValueError too.
    except ValueError as error:
        raise OptionsError(field, f"the text is not TOML ({error!s:.120}).", _REMEDY) from None


def read_size_priors(path: Path) -> dict[str, SizePrior]:
    """parse_size_priors for a file. Raises OptionsError, also where the file cannot be read."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise OptionsError(
            str(path), f"the file cannot be read ({error.strerror}).", "Check the path."
        ) from None
    except UnicodeDecodeError:
        raise OptionsError(str(path), "the file is not text.", _REMEDY) from None
    return parse_size_priors(text, str(path))
