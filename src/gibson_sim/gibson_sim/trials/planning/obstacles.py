"""Obstacles of a run: objects beside its path that leave a detour free, and people who cross the path."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.body import BodySpec
from gibson_sim.errors import ConfigError, SceneError
from gibson_sim.maps.bodies import body_triangles
from gibson_sim.maps.floor_map import FloorMap
from gibson_sim.maps.free_poses import random_free_poses
from gibson_sim.maps.free_space import XY
from gibson_sim.maps.paths import path_length
from gibson_sim.quoting import quoted
from gibson_sim.scenes.spawning import SpawnError, load_spawnable
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.trials.planning.places import NoPlaceError, Places
from gibson_sim.trials.planning.seeds import stream
from gibson_sim.trials.planning.site import Site
from gibson_sim.trials.records import Person, PlacedObject
from gibson_sim.trials.scenario.spec import SAMPLED, Obstacles, PersonRule, SpawnRule
from gibson_sim.types import Pose

F64 = NDArray[np.float64]
ON_PATH = "path"
_TRIES = 60
"""Number of places tried for an object or a person."""
_END_CLEARANCE = 0.3
"""Least distance of objects and people from the robot's circle at start and goal, metres."""
_MAX_PATH_OFFSET = 0.3
"""Largest distance of an object's origin from the edge of the robot on the path, metres."""
_PATH_PART = (0.15, 0.85)
"""Part of the path, as fractions of its length, where objects stand and people cross."""
_WALK_RANGE = (0.7, 2.5)
"""Least and largest distance of a person's turning points from the robot's path, metres."""
_SEARCH_STEP = 0.05
"""Increment in the search for turning points, metres."""


class NoRoomError(NoPlaceError):
    """No room for an obstacle in this run; there may be room with another start and goal."""


@dataclass(frozen=True, slots=True)
class _Shape:
    """The bounding box of an object's collision shapes, root frame, metres."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]

    def corners(self, x: float, y: float, yaw: float) -> F64:
        """Returns the corners (4, 2) of its footprint, world frame, metres, counter-clockwise."""
        (x0, y0, _), (x1, y1, _) = self.low, self.high
        corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
        c, s = math.cos(yaw), math.sin(yaw)
        return np.asarray(corners @ np.array([[c, s], [-s, c]]) + (x, y))

    @property
    def radius(self) -> float:
        """Radius of the circle about its origin that contains its footprint, metres."""
        return float(np.hypot(*np.abs([self.low, self.high])[:, :2].max(axis=0)))


@lru_cache(maxsize=256)
def _shape(object_name: str) -> _Shape:
    """Returns the bounding box of an object.

    Raises:
        ConfigError: the object cannot be spawned or is not an object; the message lacks the key.
    """
    try:
        body = load_spawnable(object_name, "", name="thing", pose=Pose())
    except SpawnError as error:
        raise ConfigError(f"is {quoted(object_name)}: {error}") from error
    if not isinstance(body, BodySpec):
        raise ConfigError(f"is {quoted(object_name)}, a robot; must be an object, see docs/objects.md")
    points, _ = body_triangles(SceneSpec("thing", Path(), "", (), (), bodies=(body,)))
    if not len(points):
        raise ConfigError(f"is {quoted(object_name)}, which has no collision shapes, so that nothing can touch it")
    (ax, ay, az), (bx, by, bz) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    return _Shape((ax, ay, az), (bx, by, bz))


def place_obstacles(
    site: Site, places: Places, obstacles: Obstacles, seed: int, attempt: int
) -> tuple[Places, tuple[PlacedObject, ...], tuple[Person, ...]]:
    """Places the obstacles of a run; returns start and goal with the shortest path around the objects, the objects, and the people.

    Args:
        site: scene and robot.
        places: start, goal, and the path between them.
        obstacles: obstacle rules of the scenario.
        seed: seed of the run.
        attempt: number of the attempt for this run; each attempt samples other places.

    Raises:
        NoRoomError: there is no room with this start and goal.
        NoPlaceError: a given place is not possible, or an object cannot be spawned.
    """
    if not (obstacles.spawn or obstacles.people):
        return places, (), ()
    placer = _Placer(site, places)
    objects = [
        placer.place(f"obstacles.spawn[{i}]", rule, k, stream(seed, "spawn", i, k, attempt))
        for i, rule in enumerate(obstacles.spawn)
        for k in range(rule.count)
    ]
    if objects:
        shortest, path = placer.path()
        places = replace(places, shortest=round(shortest, 4), path=path)
    people = tuple(
        _person(site, places, rule, placer.floor, f"obstacles.people[{i}]", i, stream(seed, "person", i, attempt))
        for i, rule in enumerate(obstacles.people)
    )
    return places, tuple(objects), people


class _Placer:
    """Places one object after the other on the floor."""

    def __init__(self, site: Site, places: Places) -> None:
        self._site, self._places = site, places
        self._names = {body.name for body in site.scene.bodies}
        self._next = self._space = site.space
        """Free space with the object at the place that was tried last, and without it."""

    def path(self) -> tuple[float, F64]:
        """Returns the shortest path around all objects, see ``FreeSpace.shortest``."""
        # Objects only make paths longer: a path that stays clear of them remains the shortest and needs no search.
        if self._space.contains(self._places.path):
            return self._places.shortest, self._places.path
        return self._space.shortest(self._places.start[:2], self._places.goal[:2])

    @property
    def floor(self) -> FloorMap:
        """Map with all objects."""
        return self._space.floor

    def place(self, key: str, rule: SpawnRule, number: int, rng: np.random.Generator) -> PlacedObject:
        """Returns an object at a place that leaves a detour free, and adds it to the map."""
        try:
            shape = _shape(rule.object)
        except ConfigError as error:
            raise NoPlaceError(f"{key}.object", str(error)) from error
        if rule.at not in (ON_PATH, SAMPLED):
            x, y, yaw = self._given(f"{key}.at", rule, shape)
        else:
            x, y, yaw = self._sample(key, rule, shape, rng)
        self._space = self._next
        return PlacedObject(
            self._name(rule.object, number), rule.object, (x, y, yaw), round(self._site.floor.floor_z - shape.low[2], 4)
        )

    def _sample(self, key: str, rule: SpawnRule, shape: _Shape, rng: np.random.Generator) -> tuple[float, float, float]:
        for _ in range(_TRIES):
            yaw = round(float(rng.uniform(-math.pi, math.pi)), 5)
            place = self._beside_path(rng) if rule.at == ON_PATH else self._anywhere(rng, shape)
            if place is not None and not self._problem(shape, *place, yaw):
                return (*place, yaw)
        raise NoRoomError(
            key,
            f"({quoted(rule.object)}) finds no place in scene {quoted(self._site.scene_name)} that leaves a path for robot "
            f"{quoted(self._site.robot_name)} of radius {self._site.robot.radius:.2f} m from {_text(self._places.start)} to "
            f"{_text(self._places.goal)}; fewer or smaller objects may fit",
        )

    def _given(self, key: str, rule: SpawnRule, shape: _Shape) -> tuple[float, float, float]:
        if rule.count > 1:
            raise NoPlaceError(
                key, f"is {quoted(rule.at)}, one place for {rule.count} objects; give a list with a place for each"
            )
        try:
            x, y, yaw = self._site.given_pose(rule.at)
        except ConfigError as error:
            raise NoPlaceError(key, str(error).replace("must be sampled,", "must be path, sampled,", 1)) from error
        problem = self._problem(shape, x, y, yaw)
        if problem:
            raise NoRoomError(key, f"is {quoted(rule.at)}, where {quoted(rule.object)} {problem}")
        return round(x, 6), round(y, 6), round(yaw, 6)

    def _beside_path(self, rng: np.random.Generator) -> XY:
        beside = self._site.robot.radius + _MAX_PATH_OFFSET
        at, across = rng.uniform(*_PATH_PART), rng.uniform(-beside, beside)
        (x, y), (dx, dy) = _along(self._places.path, at)
        return round(x - across * dy, 4), round(y + across * dx, 4)

    def _anywhere(self, rng: np.random.Generator, shape: _Shape) -> XY | None:
        clearance = self._site.space.clearance
        region = self._site.space.largest_region(clearance)
        try:
            (pose,) = random_free_poses(self.floor, 1, rng, clearance=min(shape.radius, clearance), region=region)
        except SceneError:
            return None
        return round(pose.position[0], 4), round(pose.position[1], 4)

    def _problem(self, shape: _Shape, x: float, y: float, yaw: float) -> str:
        """Returns why an object cannot stand at a place; empty = it can."""
        corners = shape.corners(x, y, yaw)
        cells = self.floor.grid.cover(corners[None])
        if not cells.any() or (cells & ~self.floor.free).any():
            return f"would overlap an obstacle or lie outside the map of scene {quoted(self._site.scene_name)}"
        if self._site.swept is not None and (cells & self._site.swept).any():
            return f"would block a door that closes in scene {quoted(self._site.scene_name)}"
        for end, pose in (("start", self._places.start), ("goal", self._places.goal)):
            if _distance_to_polygon(pose[:2], corners) < self._site.robot.radius + _END_CLEARANCE:
                return f"would stand within {_END_CLEARANCE:g} m of the robot at the {end} ({pose[0]:.2f}, {pose[1]:.2f})"
        self._next = self._space.with_obstacles(corners[None])
        if not self._site.leaves_path(self._next, self._places.start[:2], self._places.goal[:2]):
            return f"would leave no path from {_text(self._places.start)} to {_text(self._places.goal)}"
        return ""

    def _name(self, object_name: str, number: int) -> str:
        stem = re.sub(r"\W", "_", Path(object_name).stem, flags=re.ASCII) or "thing"
        name = next(
            text
            for k in range(number + 1, number + 3 + len(self._names))
            if (text := f"in_the_way_{stem}_{k}") not in self._names
        )
        self._names.add(name)
        return name


def _person(
    site: Site, places: Places, rule: PersonRule, floor: FloorMap, key: str, number: int, rng: np.random.Generator
) -> Person:
    """Returns a person on the path of the rule, or on a path across the robot's path."""
    path = rule.path or _across(site, places, rule, floor, key, rng)
    room = rule.radius + site.robot.radius + _END_CLEARANCE
    for point in rule.path:
        if not floor.look_up(np.ones(floor.shape, dtype=bool), point, outside=False):
            raise NoPlaceError(
                f"{key}.path", f"has ({point[0]:g}, {point[1]:g}), outside the map of scene {quoted(site.scene_name)}"
            )
    if rule.path and path_length(path) < _SEARCH_STEP:
        raise NoPlaceError(f"{key}.path", f"is {path_length(path):.2f} m long, must be {_SEARCH_STEP:g} m or more")
    if min(_distance_to_line(places.start[:2], a, b) for a, b in pairwise(path)) < room:
        raise NoRoomError(
            f"{key}.path",
            f"leads over the start {_text(places.start)} in scene {quoted(site.scene_name)}, where the robot stands before it has a goal; "
            f"must be {room:.2f} m away or more",
        )
    return Person(f"person_{number + 1}", path, rule.speed, rule.radius, rule.height)


def _across(site: Site, places: Places, rule: PersonRule, floor: FloorMap, key: str, rng: np.random.Generator) -> tuple[XY, ...]:
    """Returns two free points on opposite sides of the robot's path, with a free line between them."""
    room = rule.radius + site.robot.radius + _END_CLEARANCE
    for _ in range(_TRIES):
        (x, y), (dx, dy) = _along(places.path, float(rng.uniform(*_PATH_PART)))
        if min(math.dist((x, y), end[:2]) for end in (places.start, places.goal)) < room:
            continue
        angle = rng.uniform(-0.6, 0.6)
        c, s = math.cos(angle), math.sin(angle)
        nx, ny = -dy * c - dx * s, dx * c - dy * s
        ends = []
        for side in (1.0, -1.0):
            distances = np.arange(_SEARCH_STEP, _WALK_RANGE[1] + _SEARCH_STEP / 2, _SEARCH_STEP)
            line = np.array([x, y]) + side * distances[:, None] * np.array([nx, ny])
            free = floor.clearance(line) >= rule.radius
            walked = len(free) if free.all() else int((~free).argmax())
            ends.append(
                (
                    walked * _SEARCH_STEP,
                    (
                        round(float(x + side * walked * _SEARCH_STEP * nx), 4),
                        round(float(y + side * walked * _SEARCH_STEP * ny), 4),
                    ),
                )
            )
        if min(walked for walked, _ in ends) < _WALK_RANGE[0]:
            continue
        a, b = ends[0][1], ends[1][1]
        if _distance_to_line(places.start[:2], a, b) >= room:
            return a, b
    raise NoRoomError(
        key,
        f"finds no place in scene {quoted(site.scene_name)} to walk across the path from {_text(places.start)} to {_text(places.goal)}; "
        "give the person's path, or a longer path for the robot (sampling.path_length)",
    )


def _along(path: F64, part: float) -> tuple[XY, XY]:
    """Returns the point at a fraction of the length (0 to 1) of a path (K, 2), metres, and the unit vector along the path at this point."""
    lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
    arc = np.concatenate([[0.0], np.cumsum(lengths)])
    at = part * arc[-1]
    segment = min(int(np.searchsorted(arc, at, side="right")) - 1, len(lengths) - 1)
    dx, dy = ((path[segment + 1] - path[segment]) / max(float(lengths[segment]), 1e-9)).tolist()
    return (float(np.interp(at, arc, path[:, 0])), float(np.interp(at, arc, path[:, 1]))), (dx, dy)


def _distance_to_line(point: Sequence[float], a: XY, b: XY) -> float:
    """Returns the distance of a point from the straight line between two others, metres."""
    p, start, along = np.asarray(point), np.asarray(a), np.subtract(b, a)
    length = float(along @ along)
    part = float(np.clip((p - start) @ along / length, 0.0, 1.0)) if length else 0.0
    return float(np.linalg.norm(p - start - part * along))


def _distance_to_polygon(point: Sequence[float], corners: F64) -> float:
    """Returns the distance of a point from a convex polygon (K, 2), counter-clockwise, metres; 0 inside."""
    next_corners = np.roll(corners, -1, axis=0)
    edges, offsets = next_corners - corners, np.asarray(point) - corners
    if (edges[:, 0] * offsets[:, 1] - edges[:, 1] * offsets[:, 0] >= 0.0).all():
        return 0.0
    return min(_distance_to_line(point, tuple(a), tuple(b)) for a, b in zip(corners.tolist(), next_corners.tolist(), strict=True))


def _text(pose: Sequence[float]) -> str:
    return f"({pose[0]:.2f}, {pose[1]:.2f})"
