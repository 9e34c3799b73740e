"""docs/pictures/conventions.svg: one box seen from above in three conventions.

Nothing is drawn by hand: the corners are those of one box that boxlift's own formats convert.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from boxlift.boxes import Boxes3D
from boxlift.camera import Floats
from boxlift.formats.ego_boxes import LOOKING_AHEAD, ego_objects
from boxlift.formats.kitti_label import from_box3d
from boxlift.poses import quaternion_of

_BOX = Boxes3D(np.array([[3.0, 0.9, 7.4]]), *(np.array([side]) for side in (4.2, 1.8, 1.5, -1.1)))
_SCALE, _WIDTH, _HEIGHT = 26, 330, 400
_INK, _BLUE, _RED, _FAINT = "#24292f", "#0969da", "#cf222e", "#8c959f"


def made() -> dict[str, str | bytes]:
    """The picture by its path below docs/."""
    return {"pictures/conventions.svg": _picture()}


def _picture() -> str:
    (ego,) = ego_objects(_BOX, LOOKING_AHEAD, ["Car"], [1.0])
    kitti = from_box3d("Car", (0, 0, 0, 0), _BOX)
    w, _, _, z = quaternion_of(ego.ego_SO3_object)
    corners_cam = _BOX.bev_corners()[0]
    front_cam = corners_cam[[0, 3]].mean(axis=0)
    half = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * (ego.length_m / 2, ego.width_m / 2)
    corners_ego = half @ ego.ego_SO3_object[:2, :2].T + ego.center_ego[:2]
    front_ego = corners_ego[[0, 3]].mean(axis=0)
    panels = [
        _panel(
            "KITTI: rectified camera",
            [(x, y) for x, y in corners_cam],
            front_cam,
            ("x right", (1, 0), "z forward", (0, 1), "y down, into the page"),
            (
                f"rotation_y = {_BOX.rotation_y[0]:+.2f} rad, from x towards -z",
                f"location = centre of the BOTTOM: {_row(kitti.bottom_center_cam)}",
                f"dimensions = height, width, length: {_row(kitti.size_hwl_m)}",
            ),
        ),
        _panel(
            "ego frame: Argoverse 2, OpenLABEL, MCAP",
            # x forward is up on the page, y left is left.
            [(-y, x) for x, y in corners_ego],
            np.array([-front_ego[1], front_ego[0]]),
            ("y left", (-1, 0), "x forward", (0, 1), "z up, out of the page"),
            (
                f"yaw = {ego.yaw_rad:+.2f} rad, from x towards y",
                f"centre = of the box: {_row(ego.center_ego)}",
                f"length, width, height: {_row((ego.length_m, ego.width_m, ego.height_m))}",
                f"quaternion w = {w:.3f}, z = {z:.3f}",
            ),
        ),
    ]
    groups = "".join(
        f'<g transform="translate({_WIDTH * number + 12}, 8)">{panel}</g>\n'
        for number, panel in enumerate(panels)
    )
    size = (_WIDTH * len(panels) + 24, _HEIGHT + 16)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size[0]} {size[1]}" width="{size[0]}" '
        f'font-family="sans-serif" font-size="12" fill="{_INK}">\n'
        f'<rect width="{size[0]}" height="{size[1]}" fill="white"/>\n{groups}</svg>\n'
    )


def _panel(
    title: str,
    corners: Sequence[tuple[float, float]],
    front: Floats,
    axes: tuple[str, tuple[int, int], str, tuple[int, int], str],
    notes: Sequence[str],
) -> str:
    """Corners and front with right and up on the page as metres from the origin."""

    def at(right: float, up: float) -> str:
        return f"{120 + right * _SCALE:.1f},{315 - up * _SCALE:.1f}"

    ring = " ".join(at(*corner) for corner in corners)
    center = np.mean(corners, axis=0)
    tip = center + 1.5 * (front - center)
    first, first_way, second, second_way, third = axes
    parts = [f'<text x="0" y="14" font-weight="bold">{title}</text>']
    for text, way in ((first, first_way), (second, second_way)):
        end = at(way[0] * 1.6, way[1] * 1.6)
        x, y = (float(value) for value in at(way[0] * 1.8, way[1] * 1.8).split(","))
        anchor = "middle" if way[0] == 0 else "start" if way[0] > 0 else "end"
        parts.append(_line(at(0, 0), end, _RED))
        parts.append(f'<text x="{x:.1f}" y="{y:.1f}" fill="{_RED}" text-anchor="{anchor}">{text}</text>')
    x, y = (float(value) for value in at(0, 0).split(","))
    parts.append(f'<circle cx="{x}" cy="{y}" r="4" fill="{_RED}"/>')
    parts.append(f'<text x="{x + 8}" y="{y + 16}" fill="{_FAINT}">{third}</text>')
    parts.append(f'<polygon points="{ring}" fill="{_BLUE}22" stroke="{_BLUE}" stroke-width="2"/>')
    parts.append(_line(at(*center), at(*tip), _BLUE))
    x, y = (float(value) for value in at(*tip).split(","))
    parts.append(f'<text x="{x + 6:.1f}" y="{y:.1f}" fill="{_BLUE}">front</text>')
    parts += [
        f'<text x="0" y="{345 + 16 * row}" font-size="11">{note}</text>' for row, note in enumerate(notes)
    ]
    return "".join(parts)


def _line(start: str, end: str, color: str) -> str:
    return f'<path d="M{start} L{end}" stroke="{color}" stroke-width="2" fill="none"/>'


def _row(values: Sequence[float] | Floats) -> str:
    return ", ".join(f"{value:.2f}" for value in values)
