"""The field `options`: which preset a request chooses, and what it sets otherwise."""

from __future__ import annotations

from collections.abc import Mapping

from boxlift.errors import OptionsError
from boxlift.formats.json_text import parse_json
from boxlift.settings import DEFAULT_PRESET, LabellerSettings
from boxlift_service.bodies.shared_parts import Part


def labeller_settings(part: Part | None, presets: Mapping[str, LabellerSettings]) -> LabellerSettings:
    """{"preset": name, group: {setting: value}} -> settings; what is left out is as the preset has it.

    Raises OptionsError.
    """
    options = parse_json(part.data, "options", OptionsError) if part else {}
    if not isinstance(options, dict):
        raise OptionsError(
            "options", f"the JSON is no object ({options!r:.60}).", 'Give e.g. {"preset": "paper"}.'
        )
    name = str(options.pop("preset", DEFAULT_PRESET))
    if name not in presets:
        raise OptionsError("options.preset", f"{name!r} is no preset.", f"Choose one of {sorted(presets)}.")
    return presets[name].with_options(options)
