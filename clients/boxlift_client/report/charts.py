"""Charts as SVG that inherits the page's colours."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from boxlift_client.report.judgement import ReliabilityBin

_WIDTH, _HEIGHT = 360, 190
_LEFT, _BOTTOM, _TOP = 40, 34, 16


def bars(title: str, x_label: str, names: Sequence[str], counts: Sequence[int]) -> str:
    """A bar for every name, its count above it."""
    highest = max(counts, default=0) or 1
    slot = (_WIDTH - _LEFT) / max(len(names), 1)
    floor = _HEIGHT - _BOTTOM
    parts = []
    for at, (name, count) in enumerate(zip(names, counts, strict=True)):
        height = (floor - _TOP) * count / highest
        x = _LEFT + at * slot
        parts.append(
            f'<rect class="bar" x="{x + 0.1 * slot:.1f}" y="{floor - height:.1f}" width="{0.8 * slot:.1f}" '
            f'height="{height:.1f}"/>'
        )
        parts.append(_text(x + slot / 2, floor - height - 3, str(count), "middle"))
        parts.append(_text(x + slot / 2, floor + 12, name, "middle"))
    parts.append(_text(_LEFT + (_WIDTH - _LEFT) / 2, _HEIGHT - 4, x_label, "middle"))
    return _svg(title, parts)


def reliability_diagram(bins: Sequence[ReliabilityBin]) -> str:
    """What was predicted (across) against what came true (up); on the diagonal the scores are honest."""
    side = _HEIGHT - _BOTTOM - _TOP

    def at(predicted: float, right: float) -> tuple[float, float]:
        return _LEFT + side * predicted, _TOP + side * (1 - right)

    (x0, y0), (x1, y1) = at(0, 0), at(1, 1)
    parts = [
        f'<path class="axis" d="M{x0} {y1}V{y0}H{x1}"/>',
        f'<path class="axis" d="M{x0} {y0}L{x1} {y1}" stroke-dasharray="4 4"/>',
    ]
    most = max((each.boxes for each in bins), default=1)
    for each in bins:
        x, y = at(each.predicted, each.right)
        radius = 3 + 6 * (each.boxes / most) ** 0.5
        label = f"{each.boxes} boxes: predicted {each.predicted:.2f}, right {each.right:.2f}"
        parts.append(
            f'<circle class="bar" cx="{x:.1f}" cy="{y:.1f}" r="{radius:.1f}"><title>{label}</title></circle>'
        )
    parts += [
        _text(x0 - 4, y0 + 4, "0", "end"),
        _text(x0 - 4, y1 + 4, "1", "end"),
        _text(x1, y0 + 14, "1", "middle"),
        _text(_LEFT + side / 2, _HEIGHT - 4, "predicted", "middle"),
        _text(x0 - 4, (y0 + y1) / 2, "right", "end"),
    ]
    return _svg("Probability of an IoU above .5, predicted and as it came", parts)


def _text(x: float, y: float, text: str, anchor: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(text)}</text>'


def _svg(title: str, parts: Sequence[str]) -> str:
    name = escape(title, quote=True)
    body = "".join(parts)
    return f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="{name}">{body}</svg>'
