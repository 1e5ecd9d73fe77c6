"""Named poses of a scene: start poses, free places, rooms and doors, computed from its floor maps."""

from __future__ import annotations

import logging
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gibson_sim.errors import SceneError
from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.maps.floor_map import FloorMap, floor_at, scene_floor_map
from gibson_sim.maps.rooms import NARROWEST_DOOR, Door, door_at, find_rooms, passages
from gibson_sim.scenes.room_spec import RoomSpec
from gibson_sim.scenes.spec import SceneSpec, StartPose
from gibson_sim.types import Pose, Vec3

logger = logging.getLogger(__name__)

FREE_PLACES = 8
"""Number of free places per floor."""
DEFAULT_RADIUS, DEFAULT_HEIGHT = 0.3, 0.5
"""Robot size for free places, metres, if the scene has no robot."""
_SPARE = 0.2
"""Additional clearance of free places beside the robot, metres, if the floor has enough room."""
_WIDEST_DOOR = 1.6
"""Maximum width of a door between two named rooms, metres; a wider passage is an opening, as between a living room and its kitchen corner."""
_THICKEST_WALL = 0.4
"""Maximum distance between the outlines of neighbouring rooms, metres."""
_ROOM_RESOLUTION = 0.1
"""Cell size of the maps in which rooms are segmented, metres."""
_MAX_CANDIDATES = 100_000
"""Maximum number of cells from which free places are chosen."""


@dataclass(frozen=True, slots=True)
class NamedPose:
    """A named pose with a bounding box."""

    name: str
    description: str
    tags: tuple[str, ...]
    pose: Pose
    """T_world_pose."""
    low: Vec3
    """Lowest corner of the box, in the frame of the pose, metres."""
    high: Vec3
    """Highest corner of the box, in the frame of the pose, metres."""


def named_poses(scene: SceneSpec) -> tuple[NamedPose, ...]:
    """Returns start poses, free places, rooms and doors of every floor, in this order; equal scenes have equal poses.

    A named room of the scene keeps its name, as in ``floor_0/kitchen``, and its pose has the largest clearance; other rooms are numbered. Doors
    are named after the rooms that they connect, as in ``floor_0/door_hall_kitchen``; wider passages are openings. The boxes of start poses and
    free places contain no static obstacles; that of a room is the bounding box of its floor.
    """
    height = max((robot.height for robot in scene.robots), default=DEFAULT_HEIGHT)
    radius = max((robot.radius for robot in scene.robots), default=DEFAULT_RADIUS)
    out: list[NamedPose] = []
    for number, floor_z in enumerate(scene.floors):
        level, tag = replace(scene, floor_z=floor_z), f"floor_{number}"
        starts = [s for s in scene.starts if floor_at(scene.floors, s.pose.position[2]) == number]
        try:
            floor = scene_floor_map(level, robot_height=height)
            large = floor.resolution >= _ROOM_RESOLUTION  # then both maps are the same
            coarse = floor if large else scene_floor_map(level, robot_height=height, resolution=_ROOM_RESOLUTION)
        except SceneError as error:
            logger.warning("scene %s: only start poses are named on %s: %s", scene.name, tag, error)
            nowhere = (0.0, 0.0, 0.0)
            out += [NamedPose(s.name, "start pose", ("start", tag), s.pose, nowhere, nowhere) for s in starts]
            continue
        out += _starts(starts, tag, floor, height)
        out += _free(level, tag, floor, radius, height)
        out += _rooms_and_doors(level, number, floor, coarse, radius, height)
    return _unique(out)


def _starts(starts: Sequence[StartPose], tag: str, floor: FloorMap, height: float) -> list[NamedPose]:
    out = []
    for start in starts:
        clearance = float(floor.clearance(np.array(start.pose.position[:2])))
        out.append(NamedPose(start.name, "start pose", ("start", tag), start.pose, *_box(clearance, height)))
    return out


def _free(scene: SceneSpec, tag: str, floor: FloorMap, radius: float, height: float) -> list[NamedPose]:
    """Returns free places far apart by farthest-point sampling, starting with the most open one."""
    region = floor.largest_free_region(radius)
    roomy = region & (floor.distance_to_obstacle >= radius + _SPARE)
    cells = np.argwhere(roomy if roomy.any() else region)
    if not len(cells):
        return []
    clearance = floor.distance_to_obstacle[tuple(cells.T)]
    chosen = [cells[int(clearance.argmax())]]
    candidates = cells[:: max(1, len(cells) // _MAX_CANDIDATES)].astype(np.float64)
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


def _rooms_and_doors(
    scene: SceneSpec, number: int, floor: FloorMap, coarse: FloorMap, radius: float, height: float
) -> list[NamedPose]:
    """Returns the poses of rooms and doors: named rooms of the scene, and others that are segmented in the map."""
    tag = f"floor_{number}"
    known = _NamedRooms([room for room in scene.rooms if room.floor == number], floor)
    out = [_named_room(place, tag, scene.floor_z, height) for place in known.places(radius)]
    rooms, doors = find_rooms(coarse)
    room_names = {i: spec.name for i, detected in enumerate(rooms) if (spec := known.room_at(detected.center)) is not None}
    others = [i for i in range(len(rooms)) if i not in room_names]
    room_names |= {i: f"room_{n}" for n, i in enumerate(others)}
    for i in others:
        room, (x, y) = rooms[i], rooms[i].center
        low: Vec3 = (room.low[0] - x, room.low[1] - y, 0.0)
        high: Vec3 = (room.high[0] - x, room.high[1] - y, height)
        pose = pose_from_xyz_rpy((x, y, scene.floor_z))
        out.append(NamedPose(f"{tag}/{room_names[i]}", f"room of {room.area:.1f} m^2", ("room", tag), pose, low, high))
    names = [room.name for room in scene.rooms if room.floor == number]
    connections = [(door, names[door.rooms[0]], names[door.rooms[1]]) for door in known.doors()]
    connections += [(door, room_names[door.rooms[0]], room_names[door.rooms[1]]) for door in doors if {*door.rooms} & {*others}]
    return out + _doors(connections, tag, scene.floor_z, height)


def _named_room(place: _RoomPlace, tag: str, floor_z: float, height: float) -> NamedPose:
    (x, y), room = place.place, place.room
    corners = np.array(room.polygon) - (x, y)
    low: Vec3 = (*(float(c) for c in corners.min(axis=0)), 0.0)  # type: ignore[assignment]
    high: Vec3 = (*(float(c) for c in corners.max(axis=0)), height)  # type: ignore[assignment]
    apart = "" if place.reachable else ", unreachable for the robot from the rest of the floor"
    text = f"room of {place.area:.1f} m^2{apart}: {room.name}"
    return NamedPose(f"{tag}/{room.name}", text, ("room", tag, room.room_class), pose_from_xyz_rpy((x, y, floor_z)), low, high)


def _doors(connections: Sequence[tuple[Door, str, str]], tag: str, floor_z: float, height: float) -> list[NamedPose]:
    """Returns the poses of passages, given with the names of their two rooms; several passages between the same rooms are numbered."""
    out: list[NamedPose] = []
    count: Counter[tuple[str, ...]] = Counter()
    for door, first, second in connections:
        what = "door" if door.width <= _WIDEST_DOOR else "opening"
        again = count[what, first, second]
        count[what, first, second] += 1
        name = f"{tag}/{what}_{first}_{second}{f'_{again}' if again else ''}"
        text = f"{what} {door.width:.1f} m wide, from {first} to {second}"
        pose = pose_from_xyz_rpy((*door.center, floor_z), (0.0, 0.0, door.yaw))
        out.append(NamedPose(name, text, (what, tag), pose, *_box(door.width / 2, height)))
    return out


def _box(clearance: float, height: float) -> tuple[Vec3, Vec3]:
    """Returns the corners of a box ``height`` metres high on the square inscribed in a circle of radius ``clearance``, metres."""
    half = clearance / math.sqrt(2.0)
    return (-half, -half, 0.0), (half, half, height)


def _unique(poses: Sequence[NamedPose]) -> tuple[NamedPose, ...]:
    """Returns the poses with unique names: a number is appended to later poses of the same name."""
    used: set[str] = set()
    out = []
    for pose in poses:
        name = next(text for text in (pose.name, *(f"{pose.name}_{i}" for i in range(2, len(poses) + 2))) if text not in used)
        used.add(name)
        out.append(replace(pose, name=name))
    return tuple(out)


@dataclass(frozen=True, slots=True)
class _RoomPlace:
    """A place for a robot in a room."""

    room: RoomSpec
    place: tuple[float, float]
    """The point farthest from obstacles and from the outline of the room, world metres."""
    area: float
    """Area of free floor in the room, square metres."""
    reachable: bool
    """Whether a path that is wide enough for the robot leads to the place from the largest region of the floor."""


class _NamedRooms:
    """The named rooms of one floor.

    Args:
        rooms: the rooms of this floor.
        floor: the map of this floor.
    """

    def __init__(self, rooms: Sequence[RoomSpec], floor: FloorMap) -> None:
        self._rooms, self._floor = rooms, floor
        self._inside: NDArray[np.int64] = np.zeros(floor.shape, dtype=np.int64)
        cells = np.argwhere(floor.free) if rooms else np.zeros((0, 2), dtype=np.int64)
        centers = floor.centers(cells)
        for number, room in reversed(list(enumerate(rooms, start=1))):
            self._inside[tuple(cells[room.contains(centers)].T)] = number
        self._labels = self._with_doorways()

    def _with_doorways(self) -> NDArray[np.int64]:
        """Returns (H, W): room number of each free cell, 0 = none; cells in doorways between outlines get the nearest room."""
        if not self._inside.any():
            return self._inside
        distance, nearest = ndimage.distance_transform_edt(self._inside == 0, self._floor.resolution, return_indices=True)
        near = self._inside[tuple(nearest)]
        return np.where(self._floor.free & (distance <= _THICKEST_WALL / 2 + self._floor.resolution), near, 0)

    def places(self, radius: float) -> list[_RoomPlace]:
        """Returns a place in each room that is large enough for a disc of ``radius`` metres, in the order of the rooms."""
        fits = self._floor.inflate(radius)
        reachable = self._floor.largest_free_region(radius)
        out = []
        for number, room in enumerate(self._rooms, start=1):
            inside = self._inside == number
            cells = np.argwhere(inside & reachable)
            is_reachable = len(cells) > 0
            if not is_reachable:
                cells = np.argwhere(inside & fits)
            if not len(cells):
                continue
            # An outline is not always a wall, so keep the place away from it too.
            within = ndimage.distance_transform_edt(np.pad(room.contains(self._centers()), 1), self._floor.resolution)[1:-1, 1:-1]
            best = cells[int(np.minimum(within, self._floor.distance_to_obstacle)[tuple(cells.T)].argmax())]
            x, y = self._floor.centers(best)
            area = float(np.count_nonzero(inside)) * self._floor.resolution**2
            out.append(_RoomPlace(room, (float(x), float(y)), area, is_reachable))
        return out

    def doors(self) -> list[Door]:
        """Returns the passages between the rooms, of any width, with indices of ``rooms``."""
        out = []
        for (first, second), pieces in passages(self._labels).items():
            for cells in pieces:
                door = door_at(self._floor, self._labels, cells, (first, second), (first - 1, second - 1))
                # Narrower passages are gaps beside furniture, or the interior of hollow walls.
                if door.width >= NARROWEST_DOOR - self._floor.resolution:
                    span = np.ptp(cells, axis=0)
                    width = float(np.hypot(*(span + (span > 0)))) * self._floor.resolution
                    out.append(replace(door, width=max(width, door.width)))
        return sorted(out, key=lambda door: (door.rooms, door.center))

    def room_at(self, xy: tuple[float, float]) -> RoomSpec | None:
        """Returns the room at a point (world metres), or None."""
        row, column = (int(i) for i in self._floor.cells(np.array(xy)))
        rows, columns = self._floor.shape
        number = int(self._labels[row, column]) if 0 <= row < rows and 0 <= column < columns else 0
        return self._rooms[number - 1] if number else None

    def _centers(self) -> NDArray[np.float64]:
        """Returns the centres of all cells, (H, W, 2), world metres."""
        rows, columns = self._floor.shape
        return self._floor.centers(np.stack(np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"), axis=-1))
