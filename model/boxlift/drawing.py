"""Pictures of a labelled frame: the image with prompts and boxes above, the bird's-eye view below.

Every prompt has a colour, shared by its 2D box, its LiDAR points and its 3D box; truth is white. The
front face of a box carries a cross, the heading in the bird's-eye view a tick.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from boxlift.boxes import Boxes3D
from boxlift.camera import Floats
from boxlift.errors import MissingExtraError
from boxlift.formats.kitti_label import KittiObject, boxes3d_of
from boxlift.frame import Frame, FrameLabels

if TYPE_CHECKING:
    from PIL import Image as PillowImage
    from PIL import ImageDraw as PillowDraw

Color = tuple[int, int, int]
Pixels = tuple[float, float]

# Distinct on dark ground and on asphalt, and without white (truth) or grey (other points).
_PALETTE: tuple[Color, ...] = (
    (255, 140, 40), (70, 200, 255), (255, 90, 170), (250, 225, 60), (160, 130, 255),
    (90, 230, 130), (255, 95, 80), (60, 225, 205), (215, 170, 120), (150, 190, 90),
)  # fmt: skip
_TRUTH: Color = (255, 255, 255)
_GROUND: Color = (18, 20, 24)
_RINGS: Color = (58, 62, 70)
_FAINT: Color = (140, 146, 156)
_FADING_M = 20.0
# Points on an image without objects, from far to near: seen on grey roads and on bright walls alike.
_FAR_TO_NEAR: tuple[Color, ...] = ((50, 40, 255), (0, 190, 255), (40, 230, 60), (255, 210, 0), (255, 40, 30))

# Lines are drawn at this scale and then averaged down, which smooths them.
_OVERSAMPLING = 2
_LEAST_WIDTH_PX, _MOST_WIDTH_PX = 960, 1920
_BEV_HEIGHT_PX = 640
_BEHIND_CAMERA_M = 3.0
_LEAST_RANGE_M, _MOST_RANGE_M = 30.0, 80.0
_NEAR_PLANE_M = 0.3
_FONT_PX = 14
_LEAST_PROMPT_FOR_SCORE_PX = 50

_EDGES = ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7))
_FRONT_CROSS = ((0, 7), (3, 4))  # diagonals of the face that looks along the heading


@dataclass(frozen=True)
class _Item:
    """One object as it is drawn: prompt and box in one colour, a short text, a line for the list."""

    color: Color
    short: str
    line: str
    prompt_px: tuple[float, float, float, float]
    box: Boxes3D | None


def draw_frame(
    frame: Frame, labels: FrameLabels | None = None, truth: Sequence[KittiObject] = ()
) -> NDArray[np.uint8]:
    """Frame, its labels and the truth as an (H, W, 3) uint8 RGB picture.

    Without labels the frame's prompts are drawn; without an image its points take the image's place.
    """
    items = []
    if labels is None:
        for index, prompt in enumerate(frame.prompts):
            text = f"#{index} {prompt.category}"
            items.append(_Item(_color(index), text, text, prompt.box_px, None))
    else:
        for label in labels.objects:
            line = f"#{label.index} {label.prompt.category}  {_range_text(label.box)}"
            line += f"{label.score:.2f}" if label.box is not None else _spelled(label.result.name)
            short = f"#{label.index} {label.score:.2f}" if label.box is not None else f"#{label.index} no box"
            items.append(_Item(_color(label.index), short, line, label.prompt.box_px, label.box))
    return _draw(frame, items, truth)


def draw_objects(
    frame: Frame, objects: Sequence[KittiObject], truth: Sequence[KittiObject] = ()
) -> NDArray[np.uint8]:
    """The same picture with boxes from KITTI label or result lines, e.g. of a label set on disk."""
    items = []
    for index, written in enumerate(label for label in objects if label.category != "DontCare"):
        box = boxes3d_of([written]) if written.has_box3d else None
        score = "" if written.score is None else f"{written.score:.2f}"
        line = f"#{index} {written.category}  {_range_text(box)}{score if box is not None else 'no box'}"
        items.append(_Item(_color(index), f"#{index} {score}".strip(), line, written.box_px, box))
    return _draw(frame, items, truth)


def _color(index: int) -> Color:
    return _PALETTE[index % len(_PALETTE)]


def _darker(color: Color) -> Color:
    red, green, blue = color
    return red * 2 // 3, green * 2 // 3, blue * 2 // 3


def _range_text(box: Boxes3D | None) -> str:
    return "" if box is None else f"{np.hypot(box.center_cam[0, 0], box.center_cam[0, 2]):.1f} m  "


def _spelled(result_name: str) -> str:
    return result_name.lower().replace("_", " ")


def _draw(frame: Frame, items: Sequence[_Item], truth: Sequence[KittiObject]) -> NDArray[np.uint8]:
    known_truth = boxes3d_of([label for label in truth if label.has_box3d])
    points_cam = frame.calibration.velo_to_cam(frame.points_velo)
    owners, pixels = _owners(frame, points_cam, items)
    image = _ImageView(frame, points_cam, pixels).draw(items, owners, known_truth)
    bev = _BirdsEyeView(image.width, frame, items, known_truth).draw(items, points_cam, owners)
    return np.concatenate([np.asarray(image), np.asarray(bev)])


def _owners(frame: Frame, points_cam: Floats, items: Sequence[_Item]) -> tuple[NDArray[np.intp], Floats]:
    """(N,) item whose prompt a point lies in (the smallest one; -1 for none), and (N, 2) its pixels."""
    pixels, depth_m = frame.calibration.project(points_cam)
    width, height = frame.image_size_px
    with np.errstate(invalid="ignore"):  # NaN behind the camera compares as outside
        visible = (depth_m > 0) & (pixels >= 0).all(axis=1) & (pixels < (width, height)).all(axis=1)
        pixels[~visible] = np.nan
        owners = np.full(len(points_cam), -1)
        areas = [(x2 - x1) * (y2 - y1) for x1, y1, x2, y2 in (item.prompt_px for item in items)]
        for index in np.argsort(areas)[::-1]:
            low, high = np.array(items[index].prompt_px).reshape(2, 2)
            inside: NDArray[np.bool_] = np.all((pixels >= low) & (pixels <= high), axis=1)
            if frame.instance_ids is not None:
                column, row = pixels[inside].astype(int).T
                inside[inside] = frame.instance_ids[row, column] == index + 1
            owners[inside] = index
    return owners, pixels


class _Canvas:
    """A picture under construction: coordinates in its final pixels, drawn finer, then averaged down."""

    def __init__(self, background: PillowImage.Image) -> None:
        scale = _OVERSAMPLING
        self.size = background.size
        self._picture = background.resize((background.width * scale, background.height * scale), 0)
        self._draw: PillowDraw.ImageDraw = _pillow("ImageDraw").Draw(self._picture)
        self._font: Any = _pillow("ImageFont").load_default(_FONT_PX * scale)

    def line(self, points: Sequence[Pixels], color: Color, width: float = 1.0) -> None:
        scaled = [(x * _OVERSAMPLING, y * _OVERSAMPLING) for x, y in points]
        self._draw.line(scaled, fill=color, width=round(width * _OVERSAMPLING), joint="curve")

    def rectangle(self, box: tuple[float, float, float, float], color: Color, width: float = 1.0) -> None:
        x1, y1, x2, y2 = box
        self.line([(x1, y1), (x2, y1), (x2, y2), (x1, y2), (x1, y1)], color, width)

    def circle(self, center: Pixels, radius: float, color: Color) -> None:
        x, y, r = (value * _OVERSAMPLING for value in (*center, radius))
        self._draw.ellipse((x - r, y - r, x + r, y + r), outline=color, width=_OVERSAMPLING)

    def dots(self, pixels: Floats, colors: NDArray[np.uint8] | Color, side: float = 1.0) -> None:
        """Squares of `side` px at (N, 2) pixels, all inside the canvas."""
        array = np.array(self._picture)
        reach = max(1, round(side * _OVERSAMPLING))
        corner = np.floor(pixels * _OVERSAMPLING - (reach - 1) / 2).astype(int)
        for dx, dy in np.ndindex(reach, reach):
            x = (corner[:, 0] + dx).clip(0, array.shape[1] - 1)
            y = (corner[:, 1] + dy).clip(0, array.shape[0] - 1)
            array[y, x] = colors
        self._picture.paste(_pillow("Image").fromarray(array))

    def text(self, position: Pixels, text: str, color: Color) -> None:
        """Text with its top left corner at `position`, moved so that it is inside the canvas."""
        right, bottom = (side / _OVERSAMPLING for side in self._draw.textbbox((0, 0), text, self._font)[2:])
        x = min(max(position[0], 2), max(2, self.size[0] - right - 3))
        y = min(max(position[1], 1), max(1, self.size[1] - bottom - 2))
        at = (x * _OVERSAMPLING, y * _OVERSAMPLING)
        outline = 2 * _OVERSAMPLING
        self._draw.text(at, text, color, self._font, stroke_width=outline, stroke_fill=_GROUND)

    def finish(self) -> PillowImage.Image:
        return self._picture.reduce(_OVERSAMPLING)


class _ImageView:
    """The camera's image, or the projected points where there is none."""

    def __init__(self, frame: Frame, points_cam: Floats, pixels: Floats) -> None:
        width, height = frame.image_size_px
        drawn_width = min(max(width, _LEAST_WIDTH_PX), _MOST_WIDTH_PX)
        self._scale = drawn_width / width
        self._calibration = frame.calibration
        self._pixels = pixels
        self._depth_m = points_cam[:, 2]
        self._has_image = frame.image is not None
        pillow = _pillow("Image")
        if frame.image is not None:
            background = pillow.fromarray(frame.image)
        else:
            background = pillow.new("RGB", (width, height), _GROUND)
        self._background = background.resize((drawn_width, max(1, round(height * self._scale))))

    def draw(self, items: Sequence[_Item], owners: NDArray[np.intp], truth: Boxes3D) -> PillowImage.Image:
        canvas = _Canvas(self._background)
        visible = ~np.isnan(self._pixels[:, 0])
        if not self._has_image or not items:
            # On an image without objects the points show whether the calibration fits.
            ramp = np.array(_FAR_TO_NEAR if self._has_image else (_RINGS, _FAINT), dtype=np.float64)
            shown = visible & (owners < 0)
            near = np.exp(-self._depth_m[shown] / _FADING_M)
            steps = np.linspace(0, 1, len(ramp))
            shades = np.stack([np.interp(near, steps, channel) for channel in ramp.T], axis=1)
            side = 2.0 if self._has_image else 1.5
            canvas.dots(self._pixels[shown] * self._scale, shades.astype(np.uint8), side=side)
        for index, item in enumerate(items):
            canvas.dots(self._pixels[owners == index] * self._scale, item.color, side=1.5)
        for item in items:
            canvas.rectangle(self._scaled(item.prompt_px), _darker(item.color))
        for item in items:
            if item.box is not None:
                self._wireframe(canvas, item.box, item.color, 1.5)
        for row in range(len(truth)):
            self._wireframe(canvas, truth[row : row + 1], _TRUTH, 0.5)
        for item in items:
            x1, y1, x2, _ = self._scaled(item.prompt_px)
            # Small prompts crowd together: their score is in the list below.
            text = item.short if x2 - x1 >= _LEAST_PROMPT_FOR_SCORE_PX else item.short.split()[0]
            canvas.text((x1, y1 - _FONT_PX - 4), text, item.color)
        return canvas.finish()

    def _scaled(self, box_px: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
        limit = 4.0 * _MOST_WIDTH_PX  # far enough outside to be invisible, near enough to be drawn
        x1, y1, x2, y2 = np.nan_to_num(np.array(box_px) * self._scale).clip(-limit, limit).tolist()
        return x1, y1, x2, y2

    def _wireframe(self, canvas: _Canvas, box: Boxes3D, color: Color, width: float) -> None:
        corners = box.corners()[0]
        for edge in _EDGES:
            self._segment(canvas, corners[list(edge)], color, width)
        for diagonal in _FRONT_CROSS:
            self._segment(canvas, corners[list(diagonal)], color, width / 2)

    def _segment(self, canvas: _Canvas, ends_cam: Floats, color: Color, width: float) -> None:
        visible = _in_front(ends_cam)
        if visible is None:
            return
        pixels, _ = self._calibration.project(visible)
        if np.isfinite(pixels).all() and np.abs(pixels).max() < 1e5:
            (x1, y1), (x2, y2) = (pixels * self._scale).tolist()
            canvas.line([(x1, y1), (x2, y2)], color, width)


def _in_front(ends_cam: Floats) -> Floats | None:
    """The part of a segment (2, 3) before the near plane, None where nothing of it is."""
    depth = ends_cam[:, 2]
    if (depth < _NEAR_PLANE_M).all():
        return None
    if (depth >= _NEAR_PLANE_M).all():
        return ends_cam
    share = (_NEAR_PLANE_M - depth[0]) / (depth[1] - depth[0])
    cut = ends_cam[0] + share * (ends_cam[1] - ends_cam[0])
    return np.stack([cut, ends_cam[int(np.argmax(depth))]])


class _BirdsEyeView:
    """x to the right, z upwards, the camera at the bottom; rings every 10 m."""

    def __init__(self, width: int, frame: Frame, items: Sequence[_Item], truth: Boxes3D) -> None:
        self._truth = truth
        edges_px = np.array([[0.0, 0.0], [frame.image_size_px[0], 0.0]])
        edges = frame.calibration.back_project(edges_px, np.full(2, 1000.0))[:, [0, 2]]
        self._left_edge, self._right_edge = edges / np.linalg.norm(edges, axis=1, keepdims=True)
        self._size = (width, _BEV_HEIGHT_PX)
        centers = [item.box.center_cam for item in items if item.box is not None] + [truth.center_cam]
        farthest = float(np.concatenate(centers)[:, 2].max(initial=0.0)) + 5
        self._range_m = min(max(10 * np.ceil(farthest / 10), _LEAST_RANGE_M), _MOST_RANGE_M)
        self._px_per_m = _BEV_HEIGHT_PX / (self._range_m + _BEHIND_CAMERA_M)

    def draw(self, items: Sequence[_Item], points_cam: Floats, owners: NDArray[np.intp]) -> PillowImage.Image:
        canvas = _Canvas(_pillow("Image").new("RGB", self._size, _GROUND))
        self._grid(canvas)
        self._points(canvas, points_cam, owners, items)
        for item in items:
            if item.box is not None:
                self._box(canvas, item.box, item.color, 2.0)
        for row in range(len(self._truth)):
            self._box(canvas, self._truth[row : row + 1], _TRUTH, 1.0)
        self._ring_labels(canvas)
        for item in items:
            if item.box is not None:
                x, y = self._pixels(item.box.bev_corners()[0]).max(axis=0)
                canvas.text((x + 3, y - _FONT_PX), item.short.split()[0], item.color)
        self._legend(canvas, items)
        return canvas.finish()

    def _pixels(self, xz: Floats) -> Floats:
        origin = np.array([self._size[0] / 2, self._size[1] - _BEHIND_CAMERA_M * self._px_per_m])
        pixels: Floats = origin + xz * np.array([self._px_per_m, -self._px_per_m])
        return pixels

    def _grid(self, canvas: _Canvas) -> None:
        camera = self._pixels(np.zeros(2))
        reach = int(np.hypot(self._range_m, self._size[0] / 2 / self._px_per_m))
        for radius in range(10, reach + 1, 10):
            canvas.circle((camera[0], camera[1]), radius * self._px_per_m, _RINGS)
        for edge in (self._left_edge, self._right_edge):
            end = self._pixels(2 * self._range_m * edge)
            canvas.line([(camera[0], camera[1]), (end[0], end[1])], _RINGS)

    def _ring_labels(self, canvas: _Canvas) -> None:
        """Along the right edge of the camera's view, where they hide little."""
        for radius in range(10, int(self._range_m) + 1, 10):
            x, y = self._pixels(radius * self._right_edge).tolist()
            canvas.text((x + 4, y), f"{radius} m", _FAINT)

    def _points(
        self, canvas: _Canvas, points_cam: Floats, owners: NDArray[np.intp], items: Sequence[_Item]
    ) -> None:
        pixels = self._pixels(points_cam[:, [0, 2]])
        shown = ((pixels >= 0) & (pixels < self._size)).all(axis=1)
        others = shown & (owners < 0)
        height = ((1.8 - points_cam[others, 1]) / 2.5).clip(0, 1)  # from the road to above a car's roof
        shades = np.array((52, 56, 64)) + height[:, None] * (np.array(_FAINT) - (52, 56, 64))
        canvas.dots(pixels[others], shades.astype(np.uint8))
        for index, item in enumerate(items):
            canvas.dots(pixels[shown & (owners == index)], item.color, side=2.0)

    def _box(self, canvas: _Canvas, box: Boxes3D, color: Color, width: float) -> None:
        corners = self._pixels(box.bev_corners()[0])
        if np.abs(corners).max() > 1e5:
            return
        ring = [(float(x), float(y)) for x, y in corners[[0, 1, 2, 3, 0]]]
        canvas.line(ring, color, width)
        center, front = corners.mean(axis=0), corners[[0, 3]].mean(axis=0)
        tip = front + 0.25 * (front - center)
        canvas.line([tuple(center.tolist()), tuple(tip.tolist())], color, width)

    def _legend(self, canvas: _Canvas, items: Sequence[_Item]) -> None:
        """Prompts at the bottom left, colours at the bottom right: corners that no camera sees."""
        rows_that_fit = 16
        lines = [(item.line, item.color) for item in items[:rows_that_fit]]
        if len(items) > rows_that_fit:
            lines.append((f"and {len(items) - rows_that_fit} more", _FAINT))
        top = self._size[1] - (_FONT_PX + 4) * len(lines) - 6
        for row, (text, color) in enumerate(lines):
            canvas.text((8, top + row * (_FONT_PX + 4)), text, color)
        notes = [("coloured: prompt, its points, its box", _FAINT)]
        if len(self._truth):
            notes.append(("white: truth", _TRUTH))
        notes.append(("cross, tick: front", _FAINT))
        top = self._size[1] - (_FONT_PX + 4) * len(notes) - 6
        for row, (text, color) in enumerate(notes):
            canvas.text((self._size[0], top + row * (_FONT_PX + 4)), text, color)


def _pillow(name: str) -> Any:
    """A module of Pillow. Raises MissingExtraError."""
    try:
        return importlib.import_module(f"PIL.{name}")
    except ModuleNotFoundError:
        raise MissingExtraError("pillow", "label") from None
