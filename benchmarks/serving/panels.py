"""The panels of a dashboard as an HTML page, for machines without Grafana."""

from __future__ import annotations

import html
import itertools
from collections.abc import Sequence
from typing import Any

from serving.prometheus import Series

_COLOURS = ("#73bf69", "#f2cc0c", "#8ab8ff", "#ff780a", "#f2495c", "#5794f2", "#b877d9", "#96d98d", "#ffb357")
_COLUMN_PX, _ROW_PX, _GAP_PX = 60, 30, 8
_STYLE = """
body { background: #111217; color: #ccccdc; font: 12px sans-serif; position: relative }
section, h2 { position: absolute; box-sizing: border-box; overflow: hidden }
section { background: #181b1f; padding: 6px 8px }
h2 { font-size: 15px; margin: 0 }
h3 { font-size: 12px; margin: 0 0 4px }
b { font-size: 30px; color: #73bf69 }
p { margin: 0; font-size: 10px; line-height: 1.2 }
text { fill: #8e8e99; font-size: 9px }
"""


def page(panels: Sequence[tuple[dict[str, Any], Sequence[Series]]], seconds: float) -> str:
    """Panels with their data, where the dashboard has them."""
    drawn = "".join(_panel(panel, data, seconds) for panel, data in panels)
    return f'<!doctype html><meta charset="utf-8"><title>boxlift</title><style>{_STYLE}</style>{drawn}'


def _panel(panel: dict[str, Any], data: Sequence[Series], seconds: float) -> str:
    place = panel["gridPos"]
    width, height = place["w"] * _COLUMN_PX - _GAP_PX, place["h"] * _ROW_PX - _GAP_PX
    box = f"left:{place['x'] * _COLUMN_PX}px;top:{place['y'] * _ROW_PX}px;width:{width}px;height:{height}px"
    title = html.escape(panel["title"])
    if panel["type"] == "row":
        return f'<h2 style="{box}">{title}</h2>'
    unit = panel["fieldConfig"]["defaults"]["unit"]
    if panel["type"] == "stat":
        by_name = panel["options"]["textMode"] == "name"
        words = [series.name if by_name else _told(series.values[-1], unit) for series in data]
        body = f"<b>{html.escape(', '.join(words))}</b>"
    else:
        body = _chart(data, seconds, width - 16, height - 90, unit)
    return f'<section style="{box}"><h3>{title}</h3>{body}</section>'


def _chart(data: Sequence[Series], seconds: float, width: int, height: int, unit: str) -> str:
    most = max((value for series in data for value in series.values), default=0.0) or 1.0
    lines, names = [], []
    for series, colour in zip(data, itertools.cycle(_COLOURS), strict=False):
        points = " ".join(
            f"{at / seconds * width:.1f},{height - value / most * (height - 10):.1f}"
            for at, value in zip(series.times_s, series.values, strict=True)
        )
        lines.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.3"/>')
        name = html.escape(series.name)
        names.append(f'<span style="color:{colour}">{name}</span> {_told(series.values[-1], unit)}')
    scale = f'<text x="2" y="9">{_told(most, unit)}</text>'
    svg = f'<svg width="{width}" height="{height}">{scale}{"".join(lines)}</svg>'
    return f"{svg}<p>{' &nbsp; '.join(names)}</p>"


def _told(value: float, unit: str) -> str:
    if unit == "percentunit":
        return f"{value:.1%}"
    if unit == "bytes":
        return f"{value / 2**20:.1f} MiB"
    return f"{value:.3g}{' s' if unit == 's' else ''}"
