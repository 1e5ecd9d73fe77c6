"""Places of a scene that have a name: where robots start, where there is room, rooms and doors. Computed from its floor map."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gibson_sim.errors import SceneError
from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.scenes.floor_map import FloorMap, scene_floor_map
from gibson_sim.scenes.rooms import find_rooms
from gibson_sim.scenes.spec import SceneSpec, StartPose
from gibson_sim.types import Pose, Vec3

logger = logging.getLogger(__name__)

FREE_PLACES = 8
"""On a floor."""
DEFAULT_RADIUS, DEFAULT_HEIGHT = 0.3, 0.5
"""Metres: of the robot that a free place is for, where the scene has none."""
_SPARE = 0.2
"""Metres beside the robot, where the floor has places with so much."""
_ROOM_RESOLUTION = 0.1
_MOST_CANDIDATES = 100_000


@dataclass(frozen=True, slots=True)
class NamedPose:
    """A place with a name."""

    name: str
    description: str
    tags: tuple[str, ...]
    pose: Pose
    """World frame."""
    low: Vec3
    """Lowest corner of a box about it, in its frame, metres."""
    high: Vec3


def named_poses(scene: SceneSpec) -> tuple[NamedPose, ...]:
    """Returns start poses, free places, rooms and doors of every floor, in this order; equal scenes have equal poses.

    The boxes of start poses, free places and doors are free of everything static; that of a room is the smallest about its floor.
    """
    height = max((robot.height for robot in scene.robots), default=DEFAULT_HEIGHT)
    radius = max((robot.radius for robot in scene.robots), default=DEFAULT_RADIUS)
    out: list[NamedPose] = []
    for number, floor_z in enumerate(scene.floors):
        level, tag = replace(scene, floor_z=floor_z), f"floor_{number}"
        starts = [s for s in scene.starts if _floor_of(scene, s.pose.position[2]) == number]
        try:
            floor = scene_floor_map(level, robot_height=height)
            coarse = scene_floor_map(level, robot_height=height, resolution=_ROOM_RESOLUTION)
        except SceneError as error:
            logger.warning("scene %s: start poses are the only ones with a name on %s: %s", scene.name, tag, error)
            nowhere = (0.0, 0.0, 0.0)
            out += [NamedPose(s.name, "start pose", ("start", tag), s.pose, nowhere, nowhere) for s in starts]
            continue
        out += _starts(starts, tag, floor, height)
        out += _free(level, tag, floor, radius, height)
        out += _rooms_and_doors(level, number, coarse, height)
    return tuple(out)


def _floor_of(scene: SceneSpec, z: float) -> int:
    """Returns the number of the highest floor that is not above ``z``, with half a metre to spare; else the lowest."""
    return max((i for i, floor_z in enumerate(scene.floors) if floor_z <= z + 0.5), default=0)


def _starts(starts: Sequence[StartPose], tag: str, floor: FloorMap, height: float) -> list[NamedPose]:
    out = []
    for start in starts:
        clearance = float(floor.clearance(np.array(start.pose.position[:2])))
        out.append(NamedPose(start.name, "start pose", ("start", tag), start.pose, *_box(clearance, height)))
    return out


def _free(scene: SceneSpec, tag: str, floor: FloorMap, radius: float, height: float) -> list[NamedPose]:
    """Returns free places far from each other: the most open one first, then always the one farthest from all before."""
    region = floor.largest_free_region(radius)
    roomy = region & (floor.distance_to_obstacle >= radius + _SPARE)
    cells = np.argwhere(roomy if roomy.any() else region)
    if not len(cells):
        return []
    clearance = floor.distance_to_obstacle[tuple(cells.T)]
    chosen = [cells[int(clearance.argmax())]]
    candidates = cells[:: max(1, len(cells) // _MOST_CANDIDATES)].astype(np.float64)
    distance = np.full(len(candidates), np.inf)
    while len(chosen) < FREE_PLACES:
        distance = np.minimum(distance, np.sum((candidates - chosen[-1]) ** 2, axis=1))
        farthest = int(distance.argmax())
        if distance[farthest] == 0.0:
            break
        chosen.append(candidates[farthest].astype(np.int64))
    out = []
    for i, cell in enumerate(chosen):
        x, y = (float(c) for c in floor.centers(cell))
        room = float(floor.distance_to_obstacle[tuple(cell)])
        pose = pose_from_xyz_rpy((x, y, scene.floor_z))
        out.append(NamedPose(f"{tag}/free_{i}", f"{room:.2f} m from the nearest thing", ("free", tag), pose, *_box(room, height)))
    return out


def _rooms_and_doors(scene: SceneSpec, number: int, floor: FloorMap, height: float) -> list[NamedPose]:
    rooms, doors = find_rooms(floor)
    tag = f"floor_{number}"
    out = []
    for i, room in enumerate(rooms):
        x, y = room.center
        low: Vec3 = (room.low[0] - x, room.low[1] - y, 0.0)
        high: Vec3 = (room.high[0] - x, room.high[1] - y, height)
        pose = pose_from_xyz_rpy((x, y, scene.floor_z))
        named = scene.room_at(x, y, number)
        text = f"room of {room.area:.1f} m^2{'' if named is None else f': {named.name}'}"
        tags = ("room", tag, *(() if named is None else (named.room_class,)))
        out.append(NamedPose(f"{tag}/room_{i}", text, tags, pose, low, high))
    for i, door in enumerate(doors):
        pose = pose_from_xyz_rpy((*door.center, scene.floor_z), (0.0, 0.0, door.yaw))
        text = f"door {door.width:.1f} m wide, from room_{door.rooms[0]} to room_{door.rooms[1]}"
        out.append(NamedPose(f"{tag}/door_{i}", text, ("door", tag), pose, *_box(door.width / 2, height)))
    return out


def _box(clearance: float, height: float) -> tuple[Vec3, Vec3]:
    """Returns the corners of the square within a circle of radius ``clearance``, as high as the map was made for."""
    half = clearance / math.sqrt(2.0)
    return (-half, -half, 0.0), (half, half, height)
