"""Size priors as TOML: read whole, and every refusal says where."""

from __future__ import annotations

from pathlib import Path

import pytest

from boxlift.errors import OptionsError
from boxlift.formats.size_priors import parse_size_priors, read_size_priors
from boxlift.priors import SizePrior, SizeTemplate

TRAM = """
[Tram]
height_m = 3.6
width_m = 2.4
length_m = 30
source = "Operator's data sheet"
"""


def test_classes_with_sizes_source_and_templates() -> None:
    template = TRAM.replace("[Tram]", '[[Tram.templates]]\nname = "short"').replace("30", "20")
    assert parse_size_priors(TRAM + template) == {
        "Tram": SizePrior(
            height_m=3.6,
            width_m=2.4,
            length_m=30,
            source="Operator's data sheet",
            templates=(
                SizeTemplate(
                    name="short", height_m=3.6, width_m=2.4, length_m=20, source="Operator's data sheet"
                ),
            ),
        )
    }
    assert parse_size_priors("") == {}


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("= 3.6", "= 3600", r"priors\.Tram\.height_m: .* \(got 3600\)"),
        ("= 3.6", "= nan", r"priors\.Tram\.height_m: .* finite"),
        ("= 3.6", '= "tall"', r"priors\.Tram\.height_m: .* \(got 'tall'\)"),
        ('source = "Operator\'s data sheet"', "", r"priors\.Tram\.source: it is missing"),
        ("Operator's data sheet", "", r"priors\.Tram\.source: "),
        ("width_m", "wide", r"priors\.Tram\.(width_m|wide): "),
        ("[Tram]", '["Big tram"]', r"priors\.Big tram: "),
        ("[Tram]", "[Tram", "priors: the text is not TOML"),
        ("[Tram]", "", r"priors\.height_m: "),
    ],
)
def test_a_wrong_file_says_where_and_what_to_do(before: str, after: str, words: str) -> None:
    assert before in TRAM
    with pytest.raises(OptionsError, match=words) as caught:
        parse_size_priors(TRAM.replace(before, after, 1))
    assert "in metres and a source" in caught.value.remedy


def test_files(tmp_path: Path) -> None:
    path = tmp_path / "priors.toml"
    path.write_text(TRAM, encoding="utf-8")
    assert set(read_size_priors(path)) == {"Tram"}
    path.write_bytes(b"\xff")
    with pytest.raises(OptionsError, match=r"priors\.toml: the file is not text"):
        read_size_priors(path)
    with pytest.raises(OptionsError, match=r"none\.toml: the file cannot be read"):
        read_size_priors(tmp_path / "none.toml")
