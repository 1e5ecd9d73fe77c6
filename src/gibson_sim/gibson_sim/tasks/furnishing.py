"""Places furniture against walls, with free floor in front for a robot, and objects on furniture. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import SceneError
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
"""Distance from the front edge of furniture to the stand, where a robot prepares its arm, metres."""
ROOM = 0.62
"""Radius of free floor around the stand, metres: the reach of a robot's arm while it rotates."""
REACHING = 0.47
"""Largest distance that the robot drives forward from the stand, metres."""
_BEHIND = 0.05
"""Gap between furniture and wall, metres."""
_LONGEST = 8.0
"""Search range for walls, metres."""


@dataclass(frozen=True, slots=True)
class Furniture:
    """A piece of furniture whose front faces the room."""

    item: Item
    stand: tuple[float, float]
    """World x, y of the robot's base before it reaches for the furniture, metres."""
    yaw: float
    """Heading of a robot that faces the furniture, radians."""

    def outline(self, beside: float = 0.0) -> F64:
        """Returns the corners (4, 2) of the footprint, world frame, metres, widened by ``beside`` metres on either side."""
        low, high = extent(self.item.model)
        corners = [(low[0], low[1] - beside), (high[0], low[1] - beside), (high[0], high[1] + beside), (low[0], high[1] + beside)]
        return np.array([self.point(x, y, 0.0)[:2] for x, y in corners])

    def point(self, x: float, y: float, z: float) -> Vec3:
        """Transforms a point from the frame of the furniture to the world frame, metres."""
        px, py, pz, _ = (matrix_from_pose(self.item.pose) @ (x, y, z, 1.0)).tolist()
        return px, py, pz


@lru_cache(maxsize=256)
def extent(model: str) -> tuple[Vec3, Vec3]:
    """Returns the minimum and maximum corner of the bounding box of an object's collision shapes, root frame, metres."""
    body = item_body(Item("extent", model, Pose()))
    points, _ = body_triangles(SceneSpec("extent", body.model.path.parent, "", (), (), bodies=(body,)))
    (ax, ay, az), (bx, by, bz) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    return (ax, ay, az), (bx, by, bz)


def item_centre(item: Item, obs: Observation) -> Vec3:
    """Returns the current position of the centre of an item's bounding box, world frame, metres."""
    low, high = extent(item.model)
    centre = [(a + b) / 2.0 for a, b in zip(low, high, strict=True)]
    x, y, z, _ = (matrix_from_pose(obs.links[item_root(item)]) @ (*centre, 1.0)).tolist()
    return x, y, z


def height(model: str) -> float:
    """Returns the height of an object, metres."""
    low, high = extent(model)
    return high[2] - low[2]


def place_against_wall(
    ground: Ground,
    rng: np.random.Generator,
    name: str,
    model: str,
    others: Sequence[Furniture] = (),
    *,
    beside: float = 0.05,
    behind: float = 0.0,
) -> Furniture | None:
    """Places furniture at random with its back to a wall or another static obstacle; None = no room.

    Args:
        ground: the floor and the robot.
        rng: random generator.
        name: name of the item.
        model: object whose front is at +x.
        others: furniture already placed.
        beside: free space on its left and right, metres.
        behind: free distance behind the stand, for backing up, metres.
    """
    floor = ground.space.with_obstacles([other.outline() for other in others]).floor
    try:
        poses = random_free_poses(floor, TRIES, rng, clearance=ground.space.clearance)
    except SceneError:
        return None
    low, _ = extent(model)
    for pose, quarter in zip(poses, rng.integers(4, size=TRIES).tolist(), strict=True):
        yaw = math.remainder(quarter * math.pi / 2.0, 2.0 * math.pi)
        ahead = np.array([math.cos(yaw), math.sin(yaw)])
        wall = _free_ahead(floor, pose_xy(pose), ahead)
        if wall >= _LONGEST:
            continue
        x, y = (np.array(pose_xy(pose)) + ahead * (wall - _BEHIND + low[0])).tolist()
        candidate = furniture_of(Item(name, model, on_floor(ground, x, y, yaw + math.pi)))
        if not _fits(floor, candidate, beside, behind, ground.space.clearance):
            continue
        furniture = (*others, candidate)
        furnished = ground.floor.with_obstacles([piece.outline() for piece in furniture])
        if all(float(furnished.clearance(piece.stand)) >= ROOM for piece in furniture):
            return candidate
    return None


def start_for(ground: Ground, rng: np.random.Generator, furniture: Sequence[Furniture]) -> Pose | None:
    """Samples a start pose of the robot, T_world_base, from which it can reach all stands; None = none was found."""
    space = ground.space.with_obstacles([piece.outline() for piece in furniture])
    for _ in range(TRIES):
        start = free_place(ground, rng)
        if all(space.connected(pose_xy(start), piece.stand) for piece in furniture):
            return start
    return None


def furniture_of(item: Item) -> Furniture:
    """Returns an item as furniture, with its stand."""
    yaw = math.remainder(yaw_from_quat(item.pose.quat_xyzw) + math.pi, 2.0 * math.pi)
    distance = STAND + extent(item.model)[1][0]
    x, y = pose_xy(item.pose)
    return Furniture(item, (x - distance * math.cos(yaw), y - distance * math.sin(yaw)), yaw)


def item_on_point(name: str, model: str, point: Vec3, yaw: float) -> Item:
    """Returns an item that stands on a point, world frame, metres."""
    low, _ = extent(model)
    return Item(name, model, pose_from_xyz_rpy((point[0], point[1], point[2] - low[2]), (0.0, 0.0, yaw)))


def _free_ahead(floor: FloorMap, xy: tuple[float, float], ahead: F64) -> float:
    """Returns the distance to the next obstacle in a direction (2,), metres."""
    distances = np.arange(0.0, _LONGEST, floor.resolution / 2.0)
    blocked = floor.clearance(np.array(xy) + distances[:, None] * ahead) <= 0.0
    return float(distances[int(blocked.argmax())]) if blocked.any() else _LONGEST


def _fits(floor: FloorMap, furniture: Furniture, beside: float, behind: float, clearance: float) -> bool:
    """Returns whether furniture stands on free floor and a robot has room to approach it and back up."""
    ahead = np.array([math.cos(furniture.yaw), math.sin(furniture.yaw)])
    stand = np.array(furniture.stand)
    if (
        float(floor.clearance(stand)) < ROOM
        or (floor.clearance([stand + REACHING * ahead, stand - behind * ahead]) < clearance).any()
    ):
        return False
    covered = floor.grid.cover(furniture.outline(beside)[None])
    return not bool((covered & ~floor.free).any())
