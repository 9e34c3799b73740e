from __future__ import annotations

import pytest
from pydantic import BaseModel, ValidationError

from boxlift.errors import OptionsError
from boxlift.settings import PAPER, PRESETS, RELEASE, preset


def test_presets_hold_the_published_constants() -> None:
    assert PAPER.loss.density_radius_m == 0.4
    assert PAPER.loss.center_weight == 0.1
    assert PAPER.heading.x_extent_threshold_m == 3.0
    assert PAPER.points.sample_count == 100
    assert RELEASE.loss.density_radius_m == 0.2
    assert RELEASE.heading.x_extent_threshold_m == 4.0
    assert not RELEASE.ground.remove
    assert {name: settings.preset for name, settings in PRESETS.items()} == {n: n for n in PRESETS}


def test_options_lie_over_a_preset() -> None:
    changed = PAPER.with_options({"loss": {"ray_weight": 0.5}, "fit": {"method": "adam"}})
    assert (changed.loss.ray_weight, changed.loss.center_weight) == (0.5, 0.1)
    assert changed.fit.method == "adam"
    assert PAPER.loss.ray_weight == 1.0
    assert changed.fingerprint() != PAPER.fingerprint()
    assert PAPER.with_options({}).fingerprint() == PAPER.fingerprint()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"fit": {"methd": "adam"}}, "options.fit.methd"),
        ({"fit": {"method": "magic"}}, "'magic'"),
        ({"loss": {"ray_weight": -1}}, "options.loss.ray_weight"),
        ({"loss": {"ray_weight": float("nan")}}, "options.loss.ray_weight"),
        ({"loss": 3}, "options.loss"),
        ({"nonsense": 1}, "options.nonsense"),
    ],
)
def test_wrong_options_name_themselves(options: dict[str, object], words: str) -> None:
    with pytest.raises(OptionsError) as caught:
        PAPER.with_options(options)
    assert words in str(caught.value)


def test_unknown_preset() -> None:
    with pytest.raises(OptionsError, match="'acurate' is no preset"):
        preset("acurate")


def test_settings_are_frozen() -> None:
    with pytest.raises(ValidationError):
        PAPER.loss.ray_weight = 2.0  # type: ignore[misc]  # the point of the test


def test_every_setting_is_described() -> None:
    sections = [value for _, value in PAPER if isinstance(value, BaseModel)]
    assert len(sections) == 6
    for section in sections:
        assert all(field.description for field in type(section).model_fields.values()), section
