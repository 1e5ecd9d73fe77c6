"""Open a drawer or a cabinet door by its handle, and fetch the object inside."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.transforms import Mat4, invert, matrix_from_pose, transform_points
from gibson_sim.tasks.episode import Action, Episode, Goal, Item, Observation, item_body
from gibson_sim.tasks.furnishing import (
    Furniture,
    extent,
    furniture_of,
    height,
    item_centre,
    item_on_point,
    place_against_wall,
    start_for,
)
from gibson_sim.tasks.ground import Ground
from gibson_sim.tasks.kinds.arm_task import ArmTask, tool_position
from gibson_sim.tasks.placing import TRIES, no_room
from gibson_sim.tasks.scripts.arm import Arm, Script, Steps, creep, face, pointing, wait
from gibson_sim.tasks.scripts.handling import CLOSES_S, approach, downwards, drive_to_stand, grip, ready, take_from_above
from gibson_sim.tasks.task import Policy, generator
from gibson_sim.types import Vec3

CABINET, THING = "cabinet", "thing"
IN_DRAWERS = ("can_soda", "can_food", "cup", "mug", "glass_tumbler", "candle")
ON_SHELVES = ("can_soda", "can_food", "bottle_water", "glass_tumbler", "candle")
"""Objects that fit between the fingers; objects on a shelf are grasped from the front, so they have no handle."""
OPEN_M, OPEN_RAD = 0.20, math.radians(60.0)
"""Minimum openings at which a drawer, metres, and a door, radians, count as open."""
CLEAR = 0.10
"""Minimum distance from the centre of the object to the cabinet and its drawer at which it counts as taken out, metres."""
_BOARD = 0.177
"""Distance from the centre of a cabinet to the back of its fronts, metres; for the dimensions see docs/objects.md."""
_HANDLE_OUT = 0.042
"""Distance from the back of a front to the axis of its handle bar, metres."""
_DRAWERS_Z = (0.075, 0.285, 0.495)
_DRAWER_FLOOR, _DRAWER_DEEP, _DRAWER_HIGH = 0.024, 0.37, 0.204
_DRAWER_HANDLE_Z, _DOOR_HANDLE_Z = 0.131, 0.46
_SHELF_Z, _HINGE_Y, _DOOR_HANDLE_Y = 0.418, 0.40, 0.034
_BEHIND = 0.55
"""Free distance behind the stand before the cabinet, for backing up, metres."""
_FINGERS = 0.03
"""Opening of each finger before the handle is grasped, metres; limited because the handles of both doors are close together."""
_BEFORE = {True: 0.75, False: 0.98}
"""Distance from the base to the handle when it is grasped, for drawers (True) and doors, metres."""
_SHORT = {True: 0.014, False: 0.045}
"""Distance from the axis of the bar to the tool, metres: the finger tips are 3 cm ahead of the tool, a drawer's front 2.4 cm behind the bar.
A door rotates relative to the gripper, so its bar must not be deep between the fingers.
"""
_PULLED = {True: 0.29, False: math.radians(87.0)}
"""Opening to which the script pulls, metres and radians."""
_PULL = 0.10
"""Speed at which the handle is pulled, m/s."""
_LEAD = 0.07
"""Largest lead of the gripper's target over the door, radians."""
_ASIDE = 0.06
"""Distance that the gripper retreats from a door as it opens, metres."""
_FETCH = 0.72
"""Distance from the base to an object on a shelf when it is grasped, metres."""
_TRIES = 3


@dataclass(frozen=True, slots=True)
class CabinetFront:
    """A drawer or a door of the cabinet."""

    link: str
    slides: bool
    low: float
    """Height of a drawer's lower edge above the floor, metres."""
    side: float
    """Side of a door's hinge: 1 = +y, left as seen from inside; -1 = the other side."""

    @property
    def enough(self) -> float:
        """Minimum opening at which it counts as open, metres or radians."""
        return OPEN_M if self.slides else OPEN_RAD

    @property
    def handle(self) -> Vec3:
        """Centre of the bar, link frame, metres."""
        return (
            (_HANDLE_OUT, 0.0, _DRAWER_HANDLE_Z)
            if self.slides
            else (_HANDLE_OUT, self.side * (_DOOR_HANDLE_Y - _HINGE_Y), _DOOR_HANDLE_Z)
        )

    def opening(self, obs: Observation) -> float:
        """Returns the opening, metres or radians."""
        T_body_front = invert(matrix_from_pose(obs.links[f"{CABINET}/body"])) @ self.pose(obs)
        return (
            float(T_body_front[0, 3] - _BOARD) if self.slides else math.atan2(self.side * T_body_front[1, 0], T_body_front[0, 0])
        )

    def pose(self, obs: Observation) -> Mat4:
        """Returns T_world_front."""
        return matrix_from_pose(obs.links[f"{CABINET}/{self.link}"])

    def clearance(self, obs: Observation, thing: Item) -> float:
        """Returns the distance from the centre of an item to the box of the closed cabinet and, for a drawer, of the drawer, metres."""
        point = item_centre(thing, obs)
        distance = _distance_to_box(invert(matrix_from_pose(obs.links[f"{CABINET}/body"])), point, *extent(_MODELS[self.slides]))
        if not self.slides:
            return distance
        box = (-_DRAWER_DEEP, -0.3, 0.0), (_HANDLE_OUT + 0.006, 0.3, _DRAWER_HIGH)
        return min(distance, _distance_to_box(invert(self.pose(obs)), point, *box))


_MODELS = {True: "cabinet_drawers", False: "cabinet_doors"}
_FRONTS = (
    *(CabinetFront(f"drawer_{number}", True, low, 0.0) for number, low in enumerate(_DRAWERS_Z, 1)),
    CabinetFront("door_left", False, 0.0, 1.0), CabinetFront("door_right", False, 0.0, -1.0),
)  # fmt: skip


class OpenCabinet(ArmTask):
    """The cabinet has three drawers or two doors, all closed; the object is in one of the drawers or behind one of the doors."""

    name = "open-cabinet-and-fetch"
    environment = "OpenCabinet"
    about = "open a drawer or a cabinet door by its handle, and fetch the object inside"

    def generate(self, seed: int, ground: Ground) -> Episode:
        """Returns the episode of a seed; see ``Task.generate``. Even seeds have drawers, odd seeds doors."""
        Arm(ground.robot)
        rng = generator(self, seed)
        drawer = seed % 2 == 0
        for _ in range(TRIES // 4):
            cabinet = place_against_wall(ground, rng, CABINET, _MODELS[drawer], beside=0.05 if drawer else 0.20, behind=_BEHIND)
            start = start_for(ground, rng, (cabinet,)) if cabinet else None
            if cabinet is None or start is None:
                continue
            fronts = [front for front in _FRONTS if front.slides == drawer]
            front = fronts[int(rng.integers(len(fronts)))]
            thing = _item_inside(rng, cabinet, front)
            kind = item_body(thing).semantic_class
            text = f"Open {front.link.replace('_', ' ')} of the cabinet and fetch the {kind}."
            goal = Goal(text, thing.pose.position, CLEAR, THING, kind)
            return Episode(self.name, seed, start, (cabinet.item, thing), goal, math.nan, time_limit=180.0)
        raise no_room(
            self.name, ground, "no wall has room for a cabinet with free floor in front of it for a robot that backs up"
        )

    def remaining(self, episode: Episode, obs: Observation, ground: Ground) -> float:
        """Returns the sum of the missing opening of the front, metres or radians, the missing clearance of the object, metres, and the
        distance from the gripper to the object while it is not held, metres.
        """
        front = front_of(episode)
        reach = 0.0 if obs.held == THING else math.dist(tool_position(ground, obs), item_centre(episode.items[1], obs))
        return max(0.0, front.enough - front.opening(obs)) + max(0.0, CLEAR - front.clearance(obs, episode.items[1])) + reach

    def succeeded(self, episode: Episode, obs: Observation, ground: Ground) -> bool:
        """Returns whether the gripper holds the object outside the cabinet and the drawer or door is open."""
        front = front_of(episode)
        return obs.held == THING and front.opening(obs) >= front.enough and front.clearance(obs, episode.items[1]) >= CLEAR

    def scripted(self, episode: Episode, ground: Ground) -> Policy:
        """Returns a script that grasps the handle, pulls, releases, and grasps the object from above or from the front."""
        return Script(_FetchScript(episode, ground).steps)


def front_of(episode: Episode) -> CabinetFront:
    """Returns the drawer that holds the object, or the door in front of it."""
    cabinet, thing = episode.items
    _, y, z, _ = (invert(matrix_from_pose(cabinet.pose)) @ (*thing.pose.position, 1.0)).tolist()
    slides = cabinet.model == _MODELS[True]
    return min(
        (front for front in _FRONTS if front.slides == slides),
        key=lambda front: (abs(z - _DRAWER_FLOOR - front.low), -front.side * y),
    )


def _item_inside(rng: np.random.Generator, cabinet: Furniture, front: CabinetFront) -> Item:
    """Samples an item and its pose in a closed drawer, or on the shelf behind a closed door."""
    names = IN_DRAWERS if front.slides else ON_SHELVES
    model, yaw = names[int(rng.integers(len(names)))], float(rng.uniform(-math.pi, math.pi))
    if front.slides:
        x, y, z = _BOARD - float(rng.uniform(0.08, 0.20)), float(rng.uniform(-0.15, 0.15)), front.low + _DRAWER_FLOOR
    else:
        x, y, z = float(rng.uniform(-0.02, 0.10)), front.side * float(rng.uniform(0.12, 0.26)), _SHELF_Z
    return item_on_point(THING, model, cabinet.point(x, y, z), yaw)


def _distance_to_box(T_box_world: Mat4, point: Vec3, low: Vec3, high: Vec3) -> float:
    """Returns the distance from a world point to a box, metres; 0 inside."""
    local = transform_points(T_box_world, np.array([point]))[0]
    return float(np.linalg.norm(local - np.clip(local, low, high)))


class _FetchScript:
    """Opens the front, backs up, and fetches the object; tries again if the handle has slipped out of the gripper."""

    def __init__(self, episode: Episode, ground: Ground) -> None:
        self._ground, self._arm = ground, Arm(ground.robot)
        self._cabinet, self._thing, self._front = furniture_of(episode.items[0]), episode.items[1], front_of(episode)
        c, s = math.cos(self._cabinet.yaw), math.sin(self._cabinet.yaw)
        self._ahead, self._left = np.array([c, s, 0.0]), np.array([-s, c, 0.0])
        self._level = pointing(self._ahead, self._left)

    def steps(self, obs: Observation) -> Steps:
        """Yields the actions of the whole script."""
        for _ in range(_TRIES):
            obs = yield from drive_to_stand(obs, self._ground, self._cabinet, (self._cabinet,))
            if self._front.opening(obs) < self._front.enough:
                obs = yield from self._grasp_handle(obs)
                obs = yield from (self._pull_drawer(obs) if self._front.slides else self._swing_door(obs))
                obs = yield from (wait(obs, 1.0, Action(grasp=False)) if self._front.slides else self._leave_door(obs))
                obs = yield from creep(obs, -0.25, grasp=False)
            if self._front.opening(obs) >= self._front.enough:
                # Pulling has rotated the base slightly, and there is little room beside an open door.
                obs = yield from face(obs, self._cabinet.yaw, 0.01)
                obs = yield from (self._from_drawer(obs) if self._front.slides else self._from_shelf(obs))
                if obs.held == THING:
                    break
            obs = yield from creep(obs, -0.25, grasp=False)
            obs = yield from ready(obs, self._arm, self._handle(obs)[2], self._level, False)
        return obs

    def _handle(self, obs: Observation) -> NDArray[np.float64]:
        return np.asarray(transform_points(self._front.pose(obs), np.array([self._front.handle]))[0])

    def _grasp_handle(self, obs: Observation) -> Steps:
        """Moves the gripper to the bar and closes it: fingers above and below a drawer's bar, beside a door's bar."""
        slides = self._front.slides
        rotation = pointing(self._ahead, (0.0, 0.0, 1.0) if slides else self._left)
        handle = self._handle(obs)
        pregrasp = {name: _FINGERS for name in self._arm.fingers}
        obs = yield from ready(obs, self._arm, float(handle[2]), rotation, low=float(handle[2]))
        obs = yield from self._arm.move(obs, pregrasp, tolerance=0.003)
        ahead, _ = obs.in_base(tuple(handle[:2].tolist()))
        obs = yield from creep(obs, ahead - _BEFORE[slides])
        for back in (0.10, _SHORT[slides]):
            x, y, z = (self._handle(obs) - back * self._ahead).tolist()
            obs = yield from self._arm.straight(obs, (x, y, z), rotation, speed=0.1)
        return (yield from wait(obs, CLOSES_S, Action(grasp=True)))

    def _pull_drawer(self, obs: Observation) -> Steps:
        """Backs up with a stiff arm."""
        until = obs.time + 8.0
        while obs.held and self._front.opening(obs) < _PULLED[True] and obs.time < until:
            obs = yield Action(linear=-_PULL, grasp=True)
        return obs

    def _swing_door(self, obs: Observation) -> Steps:
        """Moves the handle about the hinge while the gripper points at the cabinet."""
        body = matrix_from_pose(obs.links[f"{CABINET}/body"])
        hinge = transform_points(body, np.array([(_BOARD, self._front.side * _HINGE_Y, 0.0)]))[0]
        begin = np.array(self._arm.tool(obs).position) - hinge
        radius, z = float(np.hypot(*begin[:2])), self._arm.tool(obs).position[2]
        angle, until = 0.0, obs.time + 20.0
        targets: Mapping[str, float] = {name: obs.joints[name] for name in self._arm.joints}
        while obs.held and self._front.opening(obs) < _PULLED[False] and obs.time < until:
            angle = min(angle + 0.1 * _PULL / radius, self._front.opening(obs) + _LEAD)
            c, s = math.cos(self._front.side * angle), math.sin(self._front.side * angle)
            x, y = hinge[0] + c * begin[0] - s * begin[1], hinge[1] + s * begin[0] + c * begin[1]
            targets = self._arm.towards_pose(obs, targets, np.array([x, y, z]), self._level)
            obs = yield Action(joints=targets, grasp=True)
        return obs

    def _leave_door(self, obs: Observation) -> Steps:
        """Opens the gripper while it retreats from the open door: opening fingers would otherwise push the door back."""
        outwards = self._front.pose(obs)[:3, 0]
        x, y, z = (np.array(self._arm.tool(obs).position) + _ASIDE * outwards).tolist()
        obs = yield from self._arm.straight(obs, (x, y, z), self._level, False, speed=0.1)
        return (yield from wait(obs, 0.5, Action(grasp=False)))

    def _from_drawer(self, obs: Observation) -> Steps:
        """Grasps the object from above, lifts it out, and backs up."""
        up = self._front.low + _DRAWER_HIGH
        obs = yield from ready(obs, self._arm, up + 0.12, downwards(obs), False, low=grip(self._thing, obs)[2])
        obs = yield from approach(obs, self._cabinet, 0.33, False, beyond=self._front.opening(obs))
        obs = yield from take_from_above(obs, self._arm, self._thing, up + CLEAR + 0.03 - item_centre(self._thing, obs)[2])
        return (yield from creep(obs, -0.25, grasp=obs.held == THING))

    def _from_shelf(self, obs: Observation) -> Steps:
        """Grasps the object from the front, and backs up."""
        x, y, z = item_centre(self._thing, obs)
        half = height(self._thing.model) / 2.0
        z += min(max(half, 0.05), 0.08) - half
        _, left = obs.in_base((x, y))
        obs = yield from ready(obs, self._arm, z, self._level, False, low=z, left=left)
        ahead, _ = obs.in_base((x, y))
        obs = yield from creep(obs, ahead - _FETCH, grasp=False)
        for back in (0.15, 0.0):
            px, py, _ = (np.array([x, y, z]) - back * self._ahead).tolist()
            obs = yield from self._arm.straight(obs, (px, py, z), self._level, False, speed=0.1)
        obs = yield from wait(obs, CLOSES_S, Action(grasp=True))
        x, y, z = self._arm.tool(obs).position
        obs = yield from self._arm.straight(obs, (x, y, z + 0.03), self._level, True, speed=0.08)
        return (yield from creep(obs, -0.45, grasp=True))
