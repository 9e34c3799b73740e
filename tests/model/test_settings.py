from __future__ import annotations

import pytest
from pydantic import BaseModel, ValidationError

from boxlift.errors import OptionsError
from boxlift.priors import SIZE_PRIORS, SizePrior
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


KART = SizePrior(height_m=0.9, width_m=1.2, length_m=1.8, source="The regulations.")


def test_sizes_lie_over_the_built_in_ones_and_change_the_fingerprint() -> None:
    assert PAPER.sizes == SIZE_PRIORS
    changed = PAPER.with_sizes({"Kart": KART})
    assert changed.sizes == {**SIZE_PRIORS, "Kart": KART}
    assert changed.fingerprint() != PAPER.fingerprint() == PAPER.with_sizes({}).fingerprint()
    assert changed.with_options({"fit": {"method": "adam"}}).sizes == changed.sizes
    other_order = PAPER.with_sizes({"Ape": KART, "Kart": KART})
    assert other_order.fingerprint() == PAPER.with_sizes({"Kart": KART, "Ape": KART}).fingerprint()
    # A size is replaced with its source, not mixed with the one before.
    with pytest.raises(OptionsError, match=r"options\.sizes\.Car\.height_m"):
        PAPER.with_options({"sizes": {"Car": {"length_m": 4.2}}})
    size = KART.model_dump() | {"source": "x"}
    assert PAPER.with_options({"sizes": {"Car": size}}).sizes["Car"].templates == ()


@pytest.mark.parametrize("wrong", [{"height_m": 1800}, {"source": " "}, {"length_m": -1}, {"depth_m": 1}])
def test_wrong_sizes_name_themselves(wrong: dict[str, object]) -> None:
    with pytest.raises(OptionsError, match=rf"options\.sizes\.Kart\.{next(iter(wrong))}"):
        PAPER.with_options({"sizes": {"Kart": KART.model_dump() | wrong}})


def test_a_class_is_one_word_of_a_kitti_line() -> None:
    with pytest.raises(OptionsError, match="Go kart"):
        PAPER.with_sizes({"Go kart": KART})


def test_every_built_in_size_is_plausible_and_has_a_source() -> None:
    for prior in SIZE_PRIORS.values():
        for size in (prior, *prior.templates):
            assert len(size.source) > 20
            assert size.width_m <= size.length_m
    assert [template.name for template in SIZE_PRIORS["Car"].templates] == [
        "typical", "supermini", "hatchback", "saloon", "estate", "SUV",
    ]  # fmt: skip


def test_unknown_preset() -> None:
    with pytest.raises(OptionsError, match="'acurate' is no preset"):
        preset("acurate")


def test_settings_are_frozen() -> None:
    with pytest.raises(ValidationError):
        PAPER.loss.ray_weight = 2.0  # type: ignore[misc]  # the point of the test


def test_every_setting_is_described() -> None:
    sections = [value for _, value in PAPER if isinstance(value, BaseModel)]
    assert len(sections) == 7
    for section in sections:
        assert all(field.description for field in type(section).model_fields.values()), section
