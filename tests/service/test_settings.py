from __future__ import annotations

from pathlib import Path

import pytest

from boxlift.errors import OptionsError
from boxlift_service import ServiceSettings
from boxlift_service.app import create_app


def test_variables_override_defaults() -> None:
    environment = {"BOXLIFT_PORT": "9000", "BOXLIFT_MAX_POINTS": "5", "BOXLIFT_URL": "not ours"}
    assert ServiceSettings.from_environment(environment) == ServiceSettings(port=9000, max_points=5)
    assert ServiceSettings.from_environment({}) == ServiceSettings()


def test_a_wrong_variable_is_named() -> None:
    with pytest.raises(OptionsError) as caught:
        ServiceSettings.from_environment({"BOXLIFT_PORT": "http"})
    assert caught.value.field == "BOXLIFT_PORT"
    assert "'http'" in caught.value.problem


def test_a_wrong_priors_file_stops_the_start(tmp_path: Path) -> None:
    settings = ServiceSettings.from_environment({"BOXLIFT_PRIORS": str(tmp_path / "none.toml")})
    with pytest.raises(OptionsError, match=r"none\.toml: the file cannot be read"):
        create_app(settings)


def test_the_service_is_closed_to_others_by_default() -> None:
    assert ServiceSettings().host == "127.0.0.1"


def test_lists_are_separated_by_commas() -> None:
    variables = {"BOXLIFT_ALLOWED_ORIGINS": "https://a.example, https://b.example,", "BOXLIFT_FETCH_FROM": ""}
    settings = ServiceSettings.from_environment(variables)
    assert settings.allowed_origins == ("https://a.example", "https://b.example")
    assert settings.fetch_from == ()
