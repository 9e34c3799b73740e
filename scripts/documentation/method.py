"""Pictures of docs/method.md: every step of the method on one object of a generated frame."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
import torch
from matplotlib.figure import Figure

from boxlift.boxes import Boxes3D
from boxlift.camera import Floats
from boxlift.datasets.generated import generate
from boxlift.faithful import fit_problems
from boxlift.fit import FitProblem
from boxlift.formats.kitti_label import boxes3d_of
from boxlift.frame import Frame
from boxlift.ground import find_ground
from boxlift.heading import main_direction
from boxlift.labeller import Labeller
from boxlift.losses import BevBoxes, balanced_loss, point_density, point_losses
from boxlift.object_points import ObjectPoints, points_in_image, select_object_points
from boxlift.settings import ACCURATE, PAPER, LossSettings

mpl.use("Agg")

_SEED, _PROMPT = 5, 6
_REACH_M, _STEP_M = 2.6, 0.05
_TRUTH, _FOUND, _GROUND, _OTHER = "#1a7f37", "#cf222e", "#b08800", "#8c959f"


@dataclass(frozen=True)
class _Subject:
    """One object of a frame, its truth, and what the paper's steps make of it."""

    frame: Frame
    truth: Boxes3D
    others: Boxes3D
    points: ObjectPoints
    problem: FitProblem


def made() -> dict[str, str | bytes]:
    """The pictures by their paths below docs/."""
    subject = _subject()
    drawn = {
        "points": _points(subject),
        "heading": _heading(subject),
        "losses": _losses(subject),
        "balance": _balance(subject),
        "hypotheses": _hypotheses(subject),
    }
    return {f"pictures/method/{name}.png": _png(figure) for name, figure in drawn.items()}


def _subject() -> _Subject:
    generated = generate(_SEED)
    frame = generated.frame
    frame = Frame(
        frame.name, frame.points_velo, frame.calibration, frame.image_size_px, frame.prompts, frame.image
    )
    visible = points_in_image(frame)
    ground = find_ground(visible.cam, frame.name, PAPER.ground)
    found = select_object_points(frame, visible, ground, PAPER.points, PAPER.sizes)
    points = found[_PROMPT]
    assert isinstance(points, ObjectPoints)
    objects = [each for each in found if isinstance(each, ObjectPoints)]
    # Two hypotheses of the heading per object, the chosen one first.
    problem = fit_problems(frame, PAPER)[2 * [each.prompt_index for each in objects].index(_PROMPT)]
    truths = boxes3d_of(list(generated.truth[: len(frame.prompts)]))
    return _Subject(frame, truths[_PROMPT : _PROMPT + 1], truths, points, problem)


def _points(subject: _Subject) -> Figure:
    """The prompt's points in the image and from above: ground, object, what else is in the 2D box."""
    frame = subject.frame
    assert frame.image is not None
    x1, y1, x2, y2 = frame.prompts[_PROMPT].box_px
    visible = points_in_image(frame)
    ground = find_ground(visible.cam, frame.name, PAPER.ground).is_ground
    column, row = visible.pixels.T
    inside = (column >= x1) & (column <= x2) & (row >= y1) & (row <= y2)
    cluster = (visible.cam[:, None] == subject.points.cluster).all(-1).any(-1)
    figure, (image, above) = _figure(2, (10, 3.6))
    image.imshow(frame.image)
    image.plot([x1, x2, x2, x1, x1], [y1, y1, y2, y2, y1], color="white", lw=1.5)
    for chosen, color, label in (
        (inside & ground, _GROUND, "ground"),
        (inside & ~ground & ~cluster, _OTHER, "behind, or of others"),
        (inside & cluster, _FOUND, "object-LiDAR-points"),
    ):
        image.scatter(*visible.pixels[chosen].T, s=3, color=color)
        above.scatter(*visible.cam[chosen][:, [0, 2]].T, s=5, color=color, label=f"{label} ({chosen.sum()})")
    image.set_xlim(x1 - 40, x2 + 40)
    image.set_ylim(y2 + 25, y1 - 25)
    image.set_axis_off()
    image.set_title("a 2D box, and the LiDAR points in it")
    _plan(above, "the same from above")
    _outline(above, subject.truth, _TRUTH, "truth")
    center = subject.truth.center_cam[0]
    above.set_xlim(center[0] - 4, center[0] + 4)
    above.set_ylim(center[2] - 2.5, center[2] + 5.5)
    above.legend(loc="upper right", fontsize=8)
    return figure


def _heading(subject: _Subject) -> Figure:
    """The histogram of directions between points, and the two headings that it leaves."""
    used = subject.points.used
    first, second = np.triu_indices(len(used), k=1)
    step = used[first] - used[second]
    directions = np.arctan2(-step[:, 2], step[:, 0]) % np.pi
    bins = round(np.pi / PAPER.heading.bin_rad)
    main = main_direction(used, PAPER.heading)
    figure, (histogram, above) = _figure(2, (10, 3.4))
    histogram.hist(np.rad2deg(directions), bins=bins, range=(0, 180), color=_OTHER)
    histogram.axvline(np.rad2deg(main), color=_FOUND, label="mean of the highest bin")
    truth = np.rad2deg(float(subject.truth.rotation_y[0]) % np.pi)
    histogram.axvline(truth, color=_TRUTH, ls="--", label="truth (modulo 180)")
    histogram.set_xlabel("direction between two points, degrees")
    histogram.set_ylabel("pairs of points")
    histogram.legend(fontsize=8)
    _plan(above, "the direction is the length's or the width's: two hypotheses")
    above.scatter(*used[:, [0, 2]].T, s=6, color="black", label="points that are used")
    middle = used.mean(axis=0)
    for angle, style in ((main, "-"), (main + np.pi / 2, ":")):
        along = np.array([np.cos(angle), -np.sin(angle)])
        ends = middle[[0, 2]] + np.outer([-2.2, 2.2], along)
        above.plot(*ends.T, color=_FOUND, ls=style)
    _outline(above, subject.truth, _TRUTH, "truth")
    above.legend(fontsize=8)
    return figure


def _losses(subject: _Subject) -> Figure:
    """What each loss says of every place that the box's centre could have."""
    settings = PAPER.loss
    centers, boxes, points, origin, valid = _grid(subject)
    losses = point_losses(points, boxes, origin, settings)
    geometric, ray, center = losses.means(valid)
    total = balanced_loss(points, valid, boxes, origin, settings)
    figure, axes = _figure(4, (12, 3.6))
    panels = (
        ("geometric alignment", geometric),
        ("ray tracing", ray),
        ("centre", center),
        ("balanced sum", total),
    )
    for axis, (title, values) in zip(axes, panels, strict=True):
        _map(axis, subject, centers, values, title)
    return figure


def _balance(subject: _Subject) -> Figure:
    """Density balancing: weights of points, and the sum with it and without."""
    settings = PAPER.loss
    plain = LossSettings(balance_by_density=False)
    centers, boxes, points, origin, valid = _grid(subject)
    figure, (weights, without, balanced) = _figure(3, (11, 3.8))
    density = point_density(points, valid, settings.density_radius_m)
    _plan(weights, "points by weight (1 / neighbours)")
    shown = weights.scatter(*points.numpy().T, s=14, c=(1 / density).numpy(), cmap="viridis")
    figure.colorbar(shown, ax=weights, shrink=0.8)
    _outline(weights, subject.truth, _TRUTH, "truth")
    _map(
        without,
        subject,
        centers,
        balanced_loss(points, valid, boxes, origin, plain),
        "sum, every point alike",
    )
    _map(balanced, subject, centers, balanced_loss(points, valid, boxes, origin, settings), "sum, balanced")
    return figure


def _hypotheses(subject: _Subject) -> Figure:
    """What `accurate` fitted and did not choose, and what it chose."""
    labels = Labeller(ACCURATE).label(subject.frame)
    vehicles = [
        label.index
        for label in labels.objects
        if label.box is not None
        and len(label.rejected) > 1
        and label.prompt.category in ("Car", "Van", "Truck")
    ]
    nearest = sorted(vehicles, key=lambda index: float(subject.others.center_cam[index, 2]))[1:5]
    figure, axes = _figure(4, (12, 3.6))
    points = points_in_image(subject.frame).cam
    for axis, index in zip(axes, nearest, strict=True):
        label = labels.objects[index]
        assert label.box is not None
        _plan(axis, f"#{index} {label.prompt.category}, probability {label.score:.2f}")
        axis.scatter(*points[:, [0, 2]].T, s=2, color=_OTHER)
        for other in label.rejected:
            _outline(axis, other.box, _OTHER)
        _outline(axis, subject.others[index : index + 1], _TRUTH)
        _outline(axis, label.box, _FOUND, width=2)
        x, _, z = label.box.center_cam[0]
        axis.set_xlim(x - 4.5, x + 4.5)
        axis.set_ylim(z - 4.5, z + 4.5)
    return figure


def _grid(subject: _Subject) -> tuple[Floats, BevBoxes, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Centres (K, 2) around the truth's, boxes there as the fit has them, and the points that it sees."""
    problem = subject.problem
    side = np.arange(-_REACH_M, _REACH_M + _STEP_M / 2, _STEP_M)
    x, z = np.meshgrid(side, side)
    centers = np.stack([x.ravel(), z.ravel()], axis=1) + subject.truth.center_cam[0, [0, 2]]
    at = torch.from_numpy(centers)
    length, width, yaw = (
        torch.full((len(at),), value, dtype=at.dtype)
        for value in (problem.length_m, problem.width_m, problem.rotation_y)
    )
    points = torch.from_numpy(problem.points_xz)
    valid = torch.ones(len(points), dtype=torch.bool)
    return centers, BevBoxes(at, length, width, yaw), points, torch.from_numpy(problem.origin_xz), valid


def _map(axis: Any, subject: _Subject, centers: Floats, values: torch.Tensor, title: str) -> None:
    side = round(len(centers) ** 0.5)
    x, z, loss = (each.reshape(side, side) for each in (*centers.T, values.numpy()))
    _plan(axis, title)
    axis.contourf(x, z, loss, levels=24, cmap="magma_r")
    axis.scatter(*subject.problem.points_xz.T, s=3, color="black")
    _outline(axis, subject.truth, _TRUTH)
    truth = subject.truth.center_cam[0]
    axis.plot(truth[0], truth[2], "+", color=_TRUTH, ms=12, mew=2, label="truth")
    best = centers[int(values.argmin())]
    axis.plot(*best, "x", color=_FOUND, ms=9, mew=2, label="lowest")
    axis.legend(fontsize=7, loc="upper right")


def _outline(axis: Any, boxes: Boxes3D, color: str, label: str | None = None, width: float = 1.2) -> None:
    corners = boxes.bev_corners()[0]
    axis.plot(*corners[[0, 1, 2, 3, 0]].T, color=color, lw=width, label=label)


def _plan(axis: Any, title: str) -> None:
    axis.set_aspect("equal")
    axis.set_title(title, fontsize=10)
    axis.set_xlabel("x right, m", fontsize=8)
    axis.set_ylabel("z forward, m", fontsize=8)
    axis.tick_params(labelsize=8)


def _figure(columns: int, size: tuple[float, float]) -> tuple[Figure, Sequence[Any]]:
    figure = Figure(figsize=size, layout="constrained", facecolor="white")
    return figure, figure.subplots(1, columns)


def _png(figure: Figure) -> bytes:
    file = io.BytesIO()
    # Without the name of the drawing program's version, which would change the bytes.
    figure.savefig(file, format="png", dpi=100, metadata={"Software": None})
    return file.getvalue()
