"""Who moves how in a generated drive: cars keep to their lane, brake for what stands before them and turn at
crossings; cyclists and people go their way. The own car drives along its lane too.

Everything is seeded by the scene alone: the same seed gives the same drive whatever the rig.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from boxlift.camera import Floats
from boxlift.datasets.generated.scene import Scene, SceneObject, footprint, overlap
from boxlift.datasets.generated.terrain import Terrain

_SPEED_M_S = {"standing": 0.0, "driving": 8.0, "crossing": 4.0, "walking": 1.3, "cycling": 4.5}
_SPREAD = 0.15
_BRAKING_M_S2, _STARTING_M_S2 = 4.0, 2.0
# A road user brakes where something stands within this, and so many seconds of its way.
_CLEARANCE_M, _CLEARANCE_S = 1.5, 0.7
_TURNING_RAD_PER_M = 0.12
_OWN_SIZE_M = (4.4, 1.8)


@dataclass
class Mover:
    """One road user on its way: place in the scene, heading left of forward, speed.

    lane: whether it follows the road, at `across` left of its middle and `turn_rad` against it.
    """

    x: float
    y: float
    heading_rad: float
    size_m: tuple[float, float]
    wanted_m_s: float
    speed_m_s: float
    lane: bool
    across: float
    turn_rad: float
    bend_rad_per_m: float

    def footprint(self, ahead_m: float = 0.0) -> Floats:
        """(4, 2) corners, or those it will have this much ahead."""
        x = self.x + ahead_m * np.cos(self.heading_rad)
        y = self.y + ahead_m * np.sin(self.heading_rad)
        return footprint((x, y), self.heading_rad, self.size_m)

    def advance(self, step_s: float, terrain: Terrain, blocked: bool) -> None:
        """Drive on for a moment, braking where the way is blocked."""
        change = -_BRAKING_M_S2 if blocked else _STARTING_M_S2
        self.speed_m_s = float(np.clip(self.speed_m_s + change * step_s, 0, self.wanted_m_s))
        way_m = self.speed_m_s * step_s
        self.x += way_m * float(np.cos(self.heading_rad))
        if self.lane:
            self.y = float(terrain.road_y(np.array(self.x))) + self.across
            self.heading_rad = terrain.road_heading(self.x) + self.turn_rad
        else:
            self.y += way_m * float(np.sin(self.heading_rad))
            self.heading_rad += way_m * self.bend_rad_per_m


class Traffic:
    """The road users of a scene and the own car, moment by moment."""

    def __init__(self, scene: Scene, seed: int, own_speed_m_s: float) -> None:
        self._scene = scene
        rng = np.random.default_rng([seed, 4])
        self._movers = [_mover(item, scene.terrain, rng) for item in scene.objects]
        across = -float(scene.terrain.road_y(np.array(0.0)))
        heading = scene.terrain.road_heading(0.0)
        self.own = Mover(0.0, 0.0, heading, _OWN_SIZE_M, own_speed_m_s, own_speed_m_s, True, across, 0.0, 0.0)

    def advance(self, step_s: float) -> None:
        """Everybody a moment on."""
        everybody = [*self._movers, self.own]
        for mover in everybody:
            if mover.wanted_m_s == 0:
                continue
            reach_m = _CLEARANCE_M + _CLEARANCE_S * mover.speed_m_s
            ahead = [mover.footprint(share * reach_m) for share in (0.3, 0.65, 1.0)]
            others = [
                other.footprint()
                for other in everybody
                if other is not mover and np.hypot(other.x - mover.x, other.y - mover.y) < reach_m + 12
            ]
            blocked = any(overlap(own, other) for own in ahead for other in others)
            place = mover.x, mover.y, mover.heading_rad
            mover.advance(step_s, self._scene.terrain, blocked)
            if any(overlap(mover.footprint(), other) for other in others):
                # Somebody came from the side.
                mover.x, mover.y, mover.heading_rad = place
                mover.speed_m_s = 0.0

    def own_place(self) -> tuple[tuple[float, float, float], float]:
        """Where the own car stands and how far left of forward it looks."""
        own = self.own
        z = float(self._scene.terrain.height(np.array(own.x), np.array(own.y)))
        return (own.x, own.y, z), own.heading_rad

    def scene(self) -> Scene:
        """The scene with everybody where they are."""
        objects = [
            _placed(item, mover, self._scene.terrain)
            for item, mover in zip(self._scene.objects, self._movers, strict=True)
        ]
        return replace(self._scene, objects=tuple(objects))


def _mover(item: SceneObject, terrain: Terrain, rng: np.random.Generator) -> Mover:
    x, y, _ = item.bottom_center
    wanted = _SPEED_M_S[item.role] * float(1 + _SPREAD * rng.normal())
    turn = item.heading_rad - terrain.road_heading(x)
    bend = 0.0
    if item.role == "crossing":
        # Those that stand aslant are turning, the same way on.
        off = float((turn + np.pi / 4) % (np.pi / 2) - np.pi / 4)
        bend = float(np.sign(off)) * _TURNING_RAD_PER_M if abs(off) > 0.2 else 0.0
    return Mover(
        x,
        y,
        item.heading_rad,
        item.size_lwh_m[:2],
        max(wanted, 0.0),
        max(wanted, 0.0),
        item.role != "crossing" and abs(float(np.sin(turn))) < 0.5,
        y - float(terrain.road_y(np.array(x))),
        turn,
        bend,
    )


def _placed(item: SceneObject, mover: Mover, terrain: Terrain) -> SceneObject:
    """The object where its mover is, with the two decimals that a label file holds."""
    if mover.wanted_m_s == 0:
        return item
    x, y = round(mover.x, 2), round(mover.y, 2)
    rotation_y = round(float((-mover.heading_rad - np.pi / 2 + np.pi) % (2 * np.pi) - np.pi), 2)
    moved = replace(item, rotation_y=rotation_y)
    length, width, _ = item.size_lwh_m
    under = np.concatenate([footprint((x, y), moved.heading_rad, (0.8 * length, width)), [[x, y]]])
    z = round(float(terrain.height(under[:, 0], under[:, 1]).mean()), 2)
    own = item.mesh.moved(tuple(-np.array(item.bottom_center)))
    mesh = own.turned(moved.heading_rad - item.heading_rad).moved((x, y, z))
    return replace(moved, mesh=mesh, bottom_center=(x, y, z))
