"""Places furniture against walls, with free floor for a robot in front, and objects on it. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import SceneError
from gibson_sim.geometry.rasterise import Grid
from gibson_sim.geometry.transforms import matrix_from_pose, pose_from_xyz_rpy, yaw_from_quat
from gibson_sim.maps.bodies import body_triangles
from gibson_sim.maps.floor_map import FloorMap
from gibson_sim.maps.free_poses import random_free_poses
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.tasks.episode import Item, Observation, item_body, item_root
from gibson_sim.tasks.ground import Ground
from gibson_sim.tasks.placing import TRIES, free_place, on_floor
from gibson_sim.tasks.scripts.driving import pose_xy
from gibson_sim.types import Pose, Vec3

F64 = NDArray[np.float64]
STAND = 0.80
"""Distance from the front edge of furniture to where a robot stands and readies its arm, metres."""
ROOM = 0.62
"""Radius of free floor around that place, metres: a robot's arm reaches so far out while it turns."""
REACHING = 0.47
"""Distance that the robot then drives on, at most, metres."""
_BEHIND = 0.05
"""Gap between furniture and wall, metres."""
_LONGEST = 8.0
"""Distance within which a wall is searched for, metres."""


@dataclass(frozen=True, slots=True)
class Furniture:
    """A piece of furniture whose front faces the room."""

    item: Item
    stand: tuple[float, float]
    """World x, y from which a robot reaches for it, metres."""
    yaw: float
    """Heading of a robot that faces it, radians."""

    def outline(self, beside: float = 0.0) -> F64:
        """Returns the corners (4, 2) of its outline, world frame, metres, widened by ``beside`` metres on either side."""
        low, high = extent(self.item.model)
        corners = [(low[0], low[1] - beside), (high[0], low[1] - beside), (high[0], high[1] + beside), (low[0], high[1] + beside)]
        return np.array([self.point(x, y, 0.0)[:2] for x, y in corners])

    def point(self, x: float, y: float, z: float) -> Vec3:
        """Returns a point of its own frame in the world frame, metres."""
        px, py, pz, _ = (matrix_from_pose(self.item.pose) @ (x, y, z, 1.0)).tolist()
        return px, py, pz


@lru_cache(maxsize=256)
def extent(model: str) -> tuple[Vec3, Vec3]:
    """Returns the lower and the upper corner of the bounding box of an object's collision shapes, root frame, metres."""
    body = item_body(Item("extent", model, Pose()))
    points, _ = body_triangles(SceneSpec("extent", body.model.path.parent, "", (), (), bodies=(body,)))
    (ax, ay, az), (bx, by, bz) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    return (ax, ay, az), (bx, by, bz)


def middle(item: Item, obs: Observation) -> Vec3:
    """Returns the present position of the centre of an item's bounding box, world frame, metres."""
    low, high = extent(item.model)
    centre = [(a + b) / 2.0 for a, b in zip(low, high, strict=True)]
    x, y, z, _ = (matrix_from_pose(obs.links[item_root(item)]) @ (*centre, 1.0)).tolist()
    return x, y, z


def height(model: str) -> float:
    """Returns the height of an object, metres."""
    low, high = extent(model)
    return high[2] - low[2]


def against_a_wall(
    ground: Ground,
    rng: np.random.Generator,
    name: str,
    model: str,
    others: Sequence[Furniture] = (),
    *,
    beside: float = 0.05,
    behind: float = 0.0,
) -> Furniture | None:
    """Returns furniture at a random place with its back to a wall or another static obstacle; None = there is no room.

    Args:
        ground: the floor and the robot.
        rng: random generator.
        name: of the item.
        model: object whose front is at +x.
        others: furniture that is already placed.
        beside: free space to its left and right, metres.
        behind: distance that a robot may back up from its place in front, metres.
    """
    floor = ground.floor_with([other.outline() for other in others]) if others else ground.floor
    try:
        drawn = random_free_poses(floor, TRIES, rng, clearance=ground.reach)
    except SceneError:
        return None
    low, _ = extent(model)
    for pose, quarter in zip(drawn, rng.integers(4, size=TRIES).tolist(), strict=True):
        yaw = math.remainder(quarter * math.pi / 2.0, 2.0 * math.pi)
        ahead = np.array([math.cos(yaw), math.sin(yaw)])
        wall = _free_ahead(floor, pose_xy(pose), ahead)
        if wall >= _LONGEST:
            continue
        x, y = (np.array(pose_xy(pose)) + ahead * (wall - _BEHIND + low[0])).tolist()
        found = standing(Item(name, model, on_floor(ground, x, y, yaw + math.pi)))
        if not _fits(floor, found, beside, behind, ground.reach):
            continue
        every = (*others, found)
        full = ground.floor_with([one.outline() for one in every])
        if all(float(full.clearance(one.stand)) >= ROOM for one in every):
            return found
    return None


def start_before(ground: Ground, rng: np.random.Generator, furniture: Sequence[Furniture]) -> Pose | None:
    """Returns a random pose of the robot, T_world_base, from which it can reach all furniture; None = none was found."""
    outlines = [one.outline() for one in furniture]
    for _ in range(TRIES):
        start = free_place(ground, rng)
        if all(ground.connected(pose_xy(start), one.stand, outlines) for one in furniture):
            return start
    return None


def standing(item: Item) -> Furniture:
    """Returns the furniture that an item is."""
    yaw = math.remainder(yaw_from_quat(item.pose.quat_xyzw) + math.pi, 2.0 * math.pi)
    away = STAND + extent(item.model)[1][0]
    x, y = pose_xy(item.pose)
    return Furniture(item, (x - away * math.cos(yaw), y - away * math.sin(yaw)), yaw)


def lying(name: str, model: str, place: Vec3, yaw: float) -> Item:
    """Returns an item that stands on a point of the world frame, metres."""
    low, _ = extent(model)
    return Item(name, model, pose_from_xyz_rpy((place[0], place[1], place[2] - low[2]), (0.0, 0.0, yaw)))


def _free_ahead(floor: FloorMap, xy: tuple[float, float], ahead: F64) -> float:
    """Returns the length of free floor in a direction (2,), metres."""
    away = np.arange(0.0, _LONGEST, floor.resolution / 2.0)
    blocked = floor.clearance(np.array(xy) + away[:, None] * ahead) <= 0.0
    return float(away[int(blocked.argmax())]) if blocked.any() else _LONGEST


def _fits(floor: FloorMap, one: Furniture, beside: float, behind: float, reach: float) -> bool:
    """Returns whether furniture stands on free floor and a robot has room to approach it and back up."""
    ahead = np.array([math.cos(one.yaw), math.sin(one.yaw)])
    stand = np.array(one.stand)
    if (
        float(floor.clearance(stand)) < ROOM
        or (floor.clearance([stand + REACHING * ahead, stand - behind * ahead]) < reach).any()
    ):
        return False
    covered = Grid(floor.resolution, floor.origin, floor.shape).cover(one.outline(beside)[None])
    return not bool((covered & ~floor.free).any())
