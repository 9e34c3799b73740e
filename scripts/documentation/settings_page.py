"""docs/settings.md and docs/options.md: every setting, from the settings themselves."""

from __future__ import annotations

from collections.abc import Iterator

from pydantic import BaseModel

from boxlift.network.config import LifterSettings, MonocularSettings
from boxlift.settings import DEFAULT_PRESET, PRESETS, LabellerSettings
from boxlift_service.settings import ENVIRONMENT_PREFIX, ServiceSettings
from documentation.schema_tables import cell, table, type_of


def made() -> dict[str, str | bytes]:
    """Both pages by their paths below docs/."""
    return {"settings.md": _service_page(), "options.md": _options_page()}


def _service_page() -> str:
    lines = [
        "# Settings of the service",
        "",
        "Environment variables; `boxlift serve` has the most used ones as options, which go before them.",
        "Made by `make docs` from the settings themselves.",
        "",
        "| Variable | Default | |",
        "|---|---|---|",
    ]
    for name, field in ServiceSettings.model_fields.items():
        default = field.default
        shown = "" if default is None or default == () else f"`{str(default).lower()}`"
        lines.append(f"| `{ENVIRONMENT_PREFIX}{name.upper()}` | {shown} | {field.description} |")
    return "\n".join(lines) + "\n"


def _options_page() -> str:
    lines = [
        "# Options of the labeller and of trainings",
        "",
        "Made by `make docs` from the settings themselves. The labeller's go into the field `options` of a",
        'request, as JSON, e.g. `{"preset": "paper", "fit": {"method": "adam"}}`, or into',
        "`boxlift.settings` from Python; a training's into its TOML file ([training](training.md)). A name",
        "that is not here, or a value out of range, is refused with a sentence.",
        "",
        "## Labeller",
        "",
        f"Presets differ in these; `{DEFAULT_PRESET}` is the default. How each part works:",
        "[the method](method.md).",
        "",
    ]
    for part in LabellerSettings.model_fields:
        if isinstance(settings := getattr(PRESETS[DEFAULT_PRESET], part), BaseModel):
            lines += _preset_table(part, type(settings))
    lines += [
        "**sizes**: typical size and its source per class, laid over the built-in ones, each class as a "
        "whole: [prompts and sizes](prompts-and-sizes.md).",
        "",
        "## Trainings",
        "",
        'For `task = "lifter"`, the head that ships:',
        "",
        *_training_tables(LifterSettings),
        'For `task = "monocular"`, the paper\'s training; parts that are above are the same here:',
        "",
        *_training_tables(MonocularSettings, known=LifterSettings),
    ]
    return "\n".join(lines)


def _preset_table(part: str, model: type[BaseModel]) -> list[str]:
    said = cell((model.__doc__ or "").split("\n\n")[0])
    presets = sorted(PRESETS, key=lambda name: name != DEFAULT_PRESET)
    lines = [
        f"### {part}",
        "",
        said,
        "",
        f"| option | values | {' | '.join(presets)} | |",
        "|---|---|---|---|---|---|",
    ]
    parts = [getattr(PRESETS[preset], part) for preset in presets]
    for name, schema in model.model_json_schema()["properties"].items():
        values = ["" if each is None else f"`{_shown(getattr(each, name))}`" for each in parts]
        row = [f"`{name}`", cell(type_of(schema)), *values, cell(schema.get("description", ""))]
        lines.append(f"| {' | '.join(row)} |")
    return [*lines, ""]


def _shown(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value).lower()


def _training_tables(model: type[BaseModel], known: type[BaseModel] | None = None) -> Iterator[str]:
    schema = model.model_json_schema()
    shown = set() if known is None else set(known.model_json_schema()["$defs"])
    yield from table({"properties": schema["properties"]}, with_defaults=True)
    yield ""
    for name, each in schema["$defs"].items():
        if name not in shown and name != "LossSettings":
            yield from ("", f"### {name}", "", cell(each.get("description", "")), "")
            # Its losses on points are the labeller's.
            yield from (line.replace("#losssettings", "#loss") for line in table(each, with_defaults=True))
            yield ""
