"""A seeded piece of town: who stands where. The same seed gives the same scene whatever the rig.

Scene frame: x forward, y left, z up, metres; the origin is the road under the camera.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from boxlift.camera import Floats
from boxlift.datasets.generated import people, scenery, vehicles
from boxlift.datasets.generated.meshes import Mesh, joined
from boxlift.datasets.generated.terrain import PAVEMENT_WIDTH_M, Terrain, random_terrain

Layout = Literal["street", "avenue", "junction", "car_park"]
_LAYOUTS: tuple[Layout, ...] = ("street", "avenue", "junction", "car_park")
_LAYOUT_SHARES = (0.4, 0.2, 0.25, 0.15)
_HALF_WIDTH_M: dict[Layout, float] = {"street": 5.4, "avenue": 3.9, "junction": 5.4, "car_park": 9.0}

_MAKERS: dict[str, Callable[[np.random.Generator], Mesh]] = {
    "Car": vehicles.car,
    "Van": vehicles.van,
    "Truck": vehicles.truck,
    "Pedestrian": people.pedestrian,
    "Cyclist": people.cyclist,
}
_PARKED = {"Car": 0.89, "Van": 0.09, "Truck": 0.02}
_MOVING = {"Car": 0.78, "Van": 0.11, "Truck": 0.07, "Cyclist": 0.04}

# What a road user is about; most stand.
Role = Literal["standing", "driving", "crossing", "walking", "cycling"]
_STANDING: Role = "standing"
_DRIVING: Role = "driving"

_GAP_M = 0.35  # between any two footprints
_OWN_CAR = ((-0.9, 0.0), 0.0, (6.0, 2.4))  # centre, heading, size of the footprint that carries the rig


@dataclass(frozen=True)
class SceneSettings:
    """What a scene holds. Factors of 1 are an ordinary town, 0 leaves the kind out.

    layout: None draws one of street, avenue, junction, car_park.
    relief: of the ground; 0 is flat, 2 hilly. parked, moving, people: how many.
    """

    layout: Layout | None = None
    relief: float = 1.0
    parked: float = 1.0
    moving: float = 1.0
    people: float = 1.0


@dataclass(frozen=True)
class SceneObject:
    """One road user. Its mesh is in the scene frame and fills its box exactly.

    size_lwh_m, bottom_center (scene frame) and rotation_y (KITTI's) have two decimals, so that a
    label file holds the exact truth. role: what it does in a drive.
    """

    category: str
    mesh: Mesh
    size_lwh_m: tuple[float, float, float]
    bottom_center: tuple[float, float, float]
    rotation_y: float
    role: Role = "standing"

    @property
    def heading_rad(self) -> float:
        """Radians left of forward."""
        return -self.rotation_y - np.pi / 2


@dataclass(frozen=True)
class Scene:
    """Road users, everything else, the ground and the light."""

    objects: tuple[SceneObject, ...]
    scenery: Mesh
    terrain: Terrain
    sun: Floats  # (3,) unit vector towards it
    overcast: float  # 0 clear, 1 no shadows


def build_scene(seed: int, settings: SceneSettings | None = None) -> Scene:
    """The scene of a seed."""
    settings = settings or SceneSettings()
    rng = np.random.default_rng([seed, 1])
    layout = settings.layout or _LAYOUTS[rng.choice(len(_LAYOUTS), p=_LAYOUT_SHARES)]
    crossings = (float(rng.uniform(14, 38)),) if layout == "junction" else ()
    terrain = random_terrain(rng, settings.relief, _HALF_WIDTH_M[layout], crossings)
    plot = _Plot(rng, terrain)
    _drive(plot, settings.moving)
    _park(plot, layout, settings.parked)
    _cross(plot, settings.moving)
    _walk_and_cycle(plot, settings.people)
    parts = _build_up(plot, layout)
    elevation, azimuth = rng.uniform(0.35, 1.1), rng.uniform(0, 2 * np.pi)
    sun = np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    overcast = float(rng.choice([0.0, 0.4, 0.9]))
    return Scene(tuple(plot.objects), joined(parts), terrain, sun, overcast)


class _Plot:
    """Places things on the ground such that no two footprints meet."""

    def __init__(self, rng: np.random.Generator, terrain: Terrain) -> None:
        self.rng = rng
        self.terrain = terrain
        self.objects: list[SceneObject] = []
        self._taken: list[Floats] = [footprint(*_OWN_CAR)]

    def free(self, x: float, y: float, heading_rad: float, length_m: float, width_m: float) -> bool:
        """Takes the footprint and says True, or False where it is taken already."""
        wanted = footprint((x, y), heading_rad, (length_m + _GAP_M, width_m + _GAP_M))
        if any(overlap(wanted, other) for other in self._taken):
            return False
        self._taken.append(footprint((x, y), heading_rad, (length_m, width_m)))
        return True

    def place(
        self, shares: dict[str, float], x: float, across: float, turn_rad: float, role: Role = "standing"
    ) -> bool:
        """One road user at x and a distance left of the road's middle, turned against the road."""
        categories = list(shares)
        category = categories[self.rng.choice(len(categories), p=list(shares.values()))]
        raw = _MAKERS[category](self.rng)
        size = (raw.upper - raw.lower).round(2)
        y = round(float(self.terrain.road_y(np.array(x))) + across, 2)
        x = round(x, 2)
        heading = self.terrain.road_heading(x) + turn_rad
        rotation_y = round(float((-heading - np.pi / 2 + np.pi) % (2 * np.pi) - np.pi), 2)
        heading = -rotation_y - np.pi / 2
        if not self.free(x, y, heading, float(size[0]), float(size[1])):
            return False
        # Boxes are upright in KITTI's convention; on a slope the body stands at the mean height.
        under = np.concatenate([footprint((x, y), heading, (0.8 * size[0], size[1])), [[x, y]]])
        z = round(float(self.terrain.height(under[:, 0], under[:, 1]).mean()), 2)
        length, width, height = (float(side) for side in size)
        mesh = raw.fitted(size).turned(heading).moved((x, y, z))
        self.objects.append(SceneObject(category, mesh, (length, width, height), (x, y, z), rotation_y, role))
        return True

    def stand(self, mesh: Mesh, x: float, across: float, turn_rad: float = 0.0) -> Mesh:
        """Scenery put on the ground at road coordinates."""
        y = float(self.terrain.road_y(np.array(x))) + across
        z = float(self.terrain.height(np.array(x), np.array(y)))
        return mesh.turned(self.terrain.road_heading(x) + turn_rad).moved((x, y, z))


def _drive(plot: _Plot, factor: float) -> None:
    """Traffic in both lanes, now and then one that pulls out at an angle."""
    rng, lane = plot.rng, 1.75
    for across, turn in ((-lane, 0.0), (lane, np.pi)):
        x = rng.uniform(7, 35) if across < 0 else rng.uniform(-15, 25)
        while x < 65:
            if rng.random() < 0.4 * factor:
                angle, role = turn + rng.normal(0, 0.03), _DRIVING
                if rng.random() < 0.1:
                    angle, role = angle + rng.uniform(-0.9, 0.9), _STANDING
                plot.place(_MOVING, x, across + rng.normal(0, 0.2), angle, role)
            x += rng.uniform(11, 34)


def _park(plot: _Plot, layout: Layout, factor: float) -> None:
    """Rows at the kerbs: along the road, or in bays at a right angle or aslant."""
    rng = plot.rng
    for side in (-1, 1):
        filled = np.clip(rng.uniform(0.0, 0.75) * factor, 0, 1)
        bays = layout == "car_park"
        if layout == "avenue":
            filled *= 0.15
        aslant = rng.choice([0.0, 0.0, 0.5])
        across = side * (plot.terrain.half_width_m - (2.7 if bays else 1.05))
        x = rng.uniform(-35, -28)
        while x < 55:
            crossing = float(plot.terrain.in_crossing(np.array(x))) > 0
            if rng.random() < filled and not crossing:
                turn = (
                    side * (np.pi / 2 - aslant)
                    if bays
                    else (0.0 if rng.random() < 0.5 + 0.45 * -side else np.pi)
                )
                if bays and rng.random() < 0.4:
                    turn += np.pi
                plot.place(_PARKED, x, across + rng.normal(0, 0.08), turn + rng.normal(0, 0.03))
            x += rng.uniform(2.6, 2.9) / np.cos(aslant) if bays else rng.uniform(5.2, 6.6)


def _cross(plot: _Plot, factor: float) -> None:
    """Vehicles on the side roads: crossing, waiting and turning."""
    rng = plot.rng
    for crossing in plot.terrain.crossings_x_m:
        for lane, turn in ((1.7, np.pi / 2), (-1.7, -np.pi / 2)):
            across = rng.uniform(-22, -8)
            while across < 22:
                if rng.random() < 0.45 * factor:
                    bend = (
                        rng.uniform(-0.8, 0.8)
                        if abs(across) < 8 and rng.random() < 0.4
                        else rng.normal(0, 0.04)
                    )
                    plot.place(_MOVING, crossing + lane, across, turn + bend, "crossing")
                across += rng.uniform(6, 14)


def _walk_and_cycle(plot: _Plot, factor: float) -> None:
    """Pedestrians on the pavements, alone or in pairs, some crossing; cyclists at the edge of the road."""
    rng, edge = plot.rng, plot.terrain.half_width_m
    for _ in range(rng.poisson(1.8 * factor)):
        side, x = rng.choice([-1, 1]), rng.uniform(5, 45)
        turn = rng.choice([0.0, np.pi]) + rng.normal(0, 0.25)
        across = side * (edge + rng.uniform(0.5, PAVEMENT_WIDTH_M - 0.3))
        if rng.random() < 0.2:
            across, turn = rng.uniform(-edge, edge), side * np.pi / 2 + rng.normal(0, 0.2)
        plot.place({"Pedestrian": 1.0}, x, across, turn, "walking")
        if rng.random() < 0.35:
            plot.place(
                {"Pedestrian": 1.0}, x + rng.normal(0, 0.2), across + rng.choice([-0.8, 0.8]), turn, "walking"
            )
    for _ in range(rng.poisson(0.8 * factor)):
        side, x = rng.choice([-1, 1]), rng.uniform(6, 50)
        across = side * (edge + rng.choice([-2.4, -0.6, 1.2]))
        turn = 0.0 if side < 0 else np.pi
        if rng.random() < 0.2:
            turn += rng.uniform(-np.pi, np.pi)
        plot.place({"Cyclist": 1.0}, x, across, turn + rng.normal(0, 0.08), "cycling")


def _build_up(plot: _Plot, layout: Layout) -> list[Mesh]:
    """Houses, walls, hedges and trees behind the pavements; poles and bushes anywhere beside the road."""
    rng, edge = plot.rng, plot.terrain.half_width_m
    parts = []
    built = 0.25 if layout == "avenue" else 0.8
    for side in (-1, 1):
        behind = edge + PAVEMENT_WIDTH_M
        setback = rng.uniform(0.2, 9)
        x = rng.uniform(-90, -75)
        while x < 120:
            length, depth = rng.uniform(8, 22), rng.uniform(8, 12)
            middle = x + length / 2
            across = side * (behind + setback + depth / 2 + rng.uniform(0, 1.5))
            near_crossing = any(abs(middle - at) < length / 2 + 6 for at in plot.terrain.crossings_x_m)
            if not near_crossing:
                if rng.random() < built and _stands_free(plot, middle, across, length, depth):
                    parts.append(plot.stand(scenery.building(rng, length, depth), middle, across))
                fence, line = rng.random(), side * (behind + 0.6)
                if setback > 1.5 and fence < 0.55 and _stands_free(plot, middle, line, length, 0.9):
                    front = (
                        scenery.wall(length - 1.2, rng.uniform(0.6, 1.9))
                        if fence < 0.2
                        else scenery.hedge(rng, length - 1.5)
                    )
                    parts.append(plot.stand(front, middle, line))
            x += length + rng.choice([0.0, 1.0, rng.uniform(3, 15)])
        for _ in range(rng.poisson(9)):
            at, across = rng.uniform(-50, 90), side * (edge + rng.uniform(0.3, 0.6))
            if _stands_free(plot, at, across, 0.3, 0.3):
                parts.append(plot.stand(scenery.pole(rng), at, across, np.pi if side < 0 else 0.0))
        for _ in range(rng.poisson(7)):
            at, across = rng.uniform(-50, 90), side * (edge + rng.choice([0.8, behind - edge + 2.5]))
            if _stands_free(plot, at, across, 0.7, 0.7):
                parts.append(plot.stand(scenery.tree(rng), at, across))
        for _ in range(rng.poisson(6)):
            at, across = rng.uniform(-40, 80), side * (behind + rng.uniform(0.8, 4))
            if _stands_free(plot, at, across, 1.6, 1.6):
                parts.append(plot.stand(scenery.bush(rng), at, across, rng.uniform(0, np.pi)))
    # A far skyline, so that no road ends in nothing.
    for x, across in ((140.0, -30.0), (142.0, 8.0), (139.0, 45.0), (-140.0, 0.0)):
        parts.append(plot.stand(scenery.building(rng, 10, rng.uniform(25, 45)), x, across))
    return parts


def _stands_free(plot: _Plot, x: float, across: float, length_m: float, width_m: float) -> bool:
    y = float(plot.terrain.road_y(np.array(x))) + across
    return plot.free(x, y, plot.terrain.road_heading(x), length_m, width_m)


def footprint(center: tuple[float, float], heading_rad: float, size_m: tuple[float, float]) -> Floats:
    """(4, 2) corners in order."""
    ahead = np.array([np.cos(heading_rad), np.sin(heading_rad)]) * size_m[0] / 2
    left = np.array([-np.sin(heading_rad), np.cos(heading_rad)]) * size_m[1] / 2
    return np.asarray(np.array([ahead + left, ahead - left, -ahead - left, left - ahead]) + center)


def overlap(one: Floats, other: Floats) -> bool:
    """Whether two rectangles meet: no side of either separates them (separating axis theorem)."""
    axes = np.stack([one[0] - one[1], one[1] - one[2], other[0] - other[1], other[1] - other[2]])
    first, second = one @ axes.T, other @ axes.T
    apart = (first.max(axis=0) < second.min(axis=0)) | (second.max(axis=0) < first.min(axis=0))
    return not bool(apart.any())
