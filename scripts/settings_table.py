"""docs/settings.md, from the settings themselves: python scripts/settings_table.py > docs/settings.md"""

from __future__ import annotations

from boxlift_service.settings import ENVIRONMENT_PREFIX, ServiceSettings


def settings_page() -> str:
    """The page as Markdown."""
    lines = [
        "# Settings of the service",
        "",
        "Environment variables; `boxlift serve` has the most used ones as options, which go before them.",
        "Made by `python scripts/settings_table.py`.",
        "",
        "| Variable | Default | |",
        "|---|---|---|",
    ]
    for name, field in ServiceSettings.model_fields.items():
        default = field.default
        shown = "" if default is None or default == () else f"`{str(default).lower()}`"
        lines.append(f"| `{ENVIRONMENT_PREFIX}{name.upper()}` | {shown} | {field.description} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(settings_page(), end="")
