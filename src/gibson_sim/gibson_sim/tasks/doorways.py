"""Where a robot has the room to pull a door open and to go through, and where it may start and end. Pure and deterministic."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gibson_sim.scenes.floor_map import FLOOR_TOLERANCE, FloorMap
from gibson_sim.scenes.maps.bodies import body_triangles
from gibson_sim.scenes.rasterise import clip_to_slab
from gibson_sim.tasks.doors import WIDE, XY, HingedDoor, backing_way
from gibson_sim.tasks.ground import Ground

Bools = NDArray[np.bool_]
F64 = NDArray[np.float64]
LEAST = math.radians(75.0)
"""A door that has no room to open so wide is left alone."""
AWAY = (0.9, 2.4)
"""Metres of start and goal from the plane of the closed door."""
_SLANTS = tuple(math.radians(angle) for angle in (45.0, 40.0, 35.0, 30.0, 25.0, 20.0))
_FARTHEST = 3.2
"""Metres of them from the middle of the doorway."""
_BESIDE = 0.05
"""Metres that a base keeps free beside it while it pulls."""
_WALL = 0.14
"""Metres from the plane of a closed door: so near to it the leaf swings within the doorway."""
_THICK = 0.03
"""Half the thickness of a leaf, with a little to spare, metres."""
_SNAP = 0.35
"""Metres to the nearest place of a robot at which it counts as there."""
_STEP = math.radians(2.0)


@dataclass(frozen=True)
class Doorway:
    """A door that can be opened, and gone through in no other way."""

    door: HingedDoor
    ground: Ground
    """With all bodies of the scene as obstacles, but for this door."""
    slant: float
    """Under which the handle is taken, see ``HingedDoor.towards``."""
    wide: float
    """How far it is pulled open, radians."""
    near: Bools
    """(H, W): where a robot may start, on the side on which it opens."""
    far: Bools
    """(H, W): where it may have to go, on the other one."""


def with_bodies(ground: Ground, without: Collection[str]) -> Ground:
    """Returns the ground with the bodies of its scene as obstacles, where they stand at load, but for those named."""
    bodies = tuple(body for body in ground.scene.bodies if body.name not in without)
    if not bodies:
        return ground
    vertices, triangles = body_triangles(replace(ground.scene, bodies=bodies))
    floor = ground.floor
    parts = clip_to_slab(vertices[triangles], floor.floor_z, floor.floor_z + ground.robot.height)
    return replace(ground, floor=ground.floor_with(parts))


def doorway(ground: Ground, door: HingedDoor, without: Collection[str] = ()) -> Doorway | None:
    """Returns the doorway of a door; None = a robot has no room there, or can go another way.

    Args:
        ground: where.
        door: hung where it shall be.
        without: names of bodies of the scene that are not there.
    """
    if abs(door.closed.position[2] - ground.floor.floor_z) > FLOOR_TOLERANCE:
        return None
    there = with_bodies(ground, without)
    rooms = {slant: _room(there, door, slant) for slant in _SLANTS}
    slant = max(rooms, key=lambda angle: rooms[angle])
    wide = rooms[slant]
    if wide < LEAST:
        return None
    shut, opened = (there.parts([leaf_outline(door, opening)]) for opening in (0.0, wide))
    before, behind = door.stance(0.0, slant), door.off(door.width / 2.0, -AWAY[0])
    near, far = (_label(shut, there.floor, place) for place in (before, behind))
    if not near or not far or near == far or _label(opened, there.floor, before) != _label(opened, there.floor, behind):
        return None
    centers = there.floor.centers(np.indices(there.floor.shape).transpose(1, 2, 0)).reshape(-1, 2)
    away = door.away(centers).reshape(there.floor.shape)
    close = np.linalg.norm(centers - np.array(door.off(door.width / 2.0, 0.0)), axis=1).reshape(away.shape) < _FARTHEST
    regions = [
        np.asarray((shut == label) & close & (side * away > AWAY[0]) & (side * away < AWAY[1]))
        for label, side in ((near, 1.0), (far, -1.0))
    ]
    return Doorway(door, there, slant, wide, regions[0], regions[1]) if all(region.any() for region in regions) else None


def leaf_outline(door: HingedDoor, opening: float) -> F64:
    """Returns the corners (4, 2) of the leaf from above, world metres, open by ``opening`` radians; without its handles."""
    end = np.array(door.at(opening, door.width))
    across = _THICK * np.array([-math.sin(door.bearing + door.sense * opening), math.cos(door.bearing + door.sense * opening)])
    hinge = np.array(door.hinge)
    return np.stack([hinge - across, end - across, end + across, hinge + across])


def _room(ground: Ground, door: HingedDoor, slant: float) -> float:
    """Returns how far a robot can pull a door open before it or the leaf touches something, radians."""
    way = backing_way(door, slant, min(WIDE, door.stop - _STEP))
    clear = ground.floor.clearance(np.concatenate([way.places, way.leaving])) >= ground.robot.radius + _BESIDE
    last = len(way.openings) - 1
    most = float(way.openings[last if clear.all() else min(last, max(0, int(clear.argmin()) - 1))])
    radii = np.arange(0.15, door.width, ground.floor.resolution / 2.0)
    for opening in np.arange(0.0, most, _STEP):
        points = np.array([door.at(float(opening), float(radius)) for radius in radii])
        cells = ground.floor.cells(points[door.away(points) > _WALL])
        if ground.floor.occupied[cells[:, 0], cells[:, 1]].any():
            return max(0.0, float(opening) - 2.0 * _STEP)
    return most


def _label(labels: NDArray[np.int32], floor: FloorMap, place: XY) -> int:
    """Returns the part of the floor nearest to a place, 0 = none is near."""
    cells = np.argwhere(labels)
    distances = np.linalg.norm(floor.centers(cells) - np.array(place), axis=1)
    if not len(cells) or distances.min() > _SNAP:
        return 0
    return int(labels[tuple(cells[int(distances.argmin())])])
