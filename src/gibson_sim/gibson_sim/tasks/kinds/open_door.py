"""Open a door by its handle, and drive through the doorway."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gibson_sim.tasks.episode import Action, Episode, Goal, Item, Observation, item_body
from gibson_sim.tasks.ground import Ground
from gibson_sim.tasks.placing import free_place, no_room, on_floor
from gibson_sim.tasks.scripts.arm import Arm, Script, Steps, creep, drive, face, pointing, wait
from gibson_sim.tasks.scripts.doors import (
    HOLD_DISTANCE,
    LEAVE,
    PULL_SPEED,
    XY,
    DoorChange,
    Doorway,
    HingedDoor,
    backing_path,
    changed_door,
    doorway,
    hinged_door,
    leaf_outline,
    scene_doors,
)
from gibson_sim.tasks.scripts.driving import Driver
from gibson_sim.tasks.task import Policy, Task, generator
from gibson_sim.types import Pose, Vec3

DOOR = "door"
WALL_X, JAMBS = 4.26, (1.75, 2.65)
"""Doorway of scene ``arena``, which has no door: x of the centre of its wall, y of its two jambs, metres."""
HINGE_INSIDE = 0.022
"""Distance from a jamb to the hinge, metres, see docs/objects.md."""
OPEN = math.radians(60.0)
"""Minimum opening at which a door counts as open, radians."""
RADIUS = 0.40
"""Distance to the goal within which it is reached, metres."""
HANDLE_HEIGHTS = (0.92, 1.10)
"""Minimum and maximum height of the handle above the floor, metres."""
DAMPINGS = (1.0, 5.0)
"""Minimum and maximum damping of the hinge, N m s/rad."""
FRICTIONS = (0.2, 2.0)
"""Minimum and maximum dry friction of the hinge, N m."""
HANDLE_FRICTIONS = (0.3, 0.6)
"""Minimum and maximum friction coefficient of the handle."""
_LEAD = 0.07
"""Largest lead of the gripper's target over the door, radians: the arm is stiff, and with more the gripper slips off the handle."""
_FARTHER = 0.3
"""Distance behind the grasping stance at which the arm is unfolded, metres."""
_PATIENCE_S = 2.5
"""Timeout of a small arm movement, seconds."""
_RELAXES_S = 0.5
"""Time that the arm holds still before the gripper opens, seconds."""
_FOLDED = (0.42, 0.95)
"""Intermediate position of the gripper before the arm is tucked: distance ahead of the base, and height above the floor, metres."""
_TRIES = 3
"""Maximum number of attempts to grasp the handle."""


class OpenDoor(Task):
    """The door is closed and opens towards the robot; its hinge is on the left or right."""

    name = "open-door"
    environment = "OpenDoor"
    about = "open a door by its handle and drive through; it opens towards the robot"
    scene = "arena"
    robot = "arm_bot"

    def generate(self, seed: int, ground: Ground) -> Episode:
        """Returns the episode of a seed; see ``Task.generate``."""
        rng = generator(self, seed)
        body, model, pose = self._sample_door(ground, rng)
        values = [float(rng.uniform(*span)) for span in (HANDLE_HEIGHTS, DAMPINGS, FRICTIONS, HANDLE_FRICTIONS)]
        text = changed_door(item_body(Item(DOOR, model, pose)).model.path, DoorChange(*values))
        others = {other.name for other in ground.scene.bodies} - {body}
        name = next(name for name in (DOOR, *(f"{DOOR}_{k}" for k in range(2, len(others) + 3))) if name not in others)
        item, removed = Item(name, model, pose, text), (body,) if body else ()
        passage = doorway(ground, item_door(item), removed)
        if passage is None:
            raise no_room(self.name, ground, "no door that a robot has the room to pull open")
        start, goal = (free_place(passage.ground, rng, region) for region in (passage.near, passage.far))
        text = f"Open the door and go through it to x = {goal.position[0]:.2f} m, y = {goal.position[1]:.2f} m."
        target = Goal(text, goal.position, RADIUS, name, "door")
        return Episode(self.name, seed, start, (item,), target, math.nan, time_limit=120.0, removed=removed)

    def _sample_door(self, ground: Ground, rng: np.random.Generator) -> tuple[str, str, Pose]:
        """Returns the name of the scene body to replace (empty = none), the model of the door, and its pose."""
        if ground.scene.name == "arena":
            # The robot is on the side of lower x of the wall (side -1) or on the other side, with the hinge on its left or right.
            side, left = (-1.0, 1.0)[int(rng.integers(2))], bool(rng.integers(2))
            hinge_high = left == (side < 0)
            y = JAMBS[1] - HINGE_INSIDE if hinge_high else JAMBS[0] + HINGE_INSIDE
            yaw = -math.pi / 2.0 if hinge_high else math.pi / 2.0
            # A left door opens to +y of its frame, which must be the robot's side.
            opens_left = -math.sin(yaw) * side > 0.0
            return "", "door_90_left" if opens_left else "door_90_right", on_floor(ground, WALL_X, y, yaw)
        doors = scene_doors(ground.scene)
        shuffled = (doors[k].body for k in rng.permutation(len(doors)) if doorway(ground, doors[k], (doors[k].body,)) is not None)
        name = next(shuffled, "")
        if not name:
            raise no_room(self.name, ground, "no door that a robot has the room to pull open and that is the only connection")
        body = next(body for body in ground.scene.bodies if body.name == name)
        return name, str(body.model.path), body.start

    def remaining(self, episode: Episode, obs: Observation, ground: Ground) -> float:
        """Returns the straight-line distance to the goal, metres, plus the missing opening of the door, radians."""
        return super().remaining(episode, obs, ground) + max(0.0, OPEN - opening(episode, obs))

    def succeeded(self, episode: Episode, obs: Observation, ground: Ground) -> bool:
        """Returns whether the base is at the goal and the door is open."""
        return super().succeeded(episode, obs, ground) and opening(episode, obs) > OPEN

    def scripted(self, episode: Episode, ground: Ground) -> Policy:
        """Returns a script that grasps the handle, pulls the door open by backing up, and drives through."""
        passage = doorway(ground, episode_door(episode), episode.removed)
        assert passage is not None, episode
        return Script(_OpenDoorScript(episode, passage).steps)


@lru_cache(maxsize=64)
def item_door(item: Item) -> HingedDoor:
    """Returns the hinged door of an item."""
    door = hinged_door(item_body(item))
    assert door is not None, item.model
    return door


def episode_door(episode: Episode) -> HingedDoor:
    """Returns the door of an episode."""
    return item_door(episode.items[0])


def opening(episode: Episode, obs: Observation) -> float:
    """Returns the opening of the door, radians."""
    return episode_door(episode).opening(obs)


def _rotation(yaw: float) -> NDArray[np.float64]:
    """Returns the axes of a gripper that points to ``yaw``, with its fingers above and below a lever."""
    return pointing((math.cos(yaw), math.sin(yaw), 0.0), (0.0, 0.0, 1.0))


class _OpenDoorScript:
    def __init__(self, episode: Episode, passage: Doorway) -> None:
        self._episode, self._doorway, self._door = episode, passage, passage.door
        self._arm = Arm(passage.ground.robot)

    def steps(self, obs: Observation) -> Steps:
        """Yields the actions of the whole script."""
        for _ in range(_TRIES):
            obs = yield from self._drive_to_handle(obs)
            obs = yield from self._grasp(obs)
            obs = yield from self._pull(obs)
            obs = yield from self._release(obs)
            if self._door.opening(obs) > OPEN:
                obs = yield from self._through(obs)
        return obs

    def _drive_to_handle(self, obs: Observation) -> Steps:
        """Drives to the stance before the handle, and prepares the arm."""
        door, opening, slant = self._door, self._door.opening(obs), self._slant(obs)
        stance = door.stance(opening, slant, HOLD_DISTANCE + _FARTHER)
        if obs.distance_to(stance) > 0.1:
            obs = yield from drive(obs, self._driver(obs, stance))
        hand = door.grip(opening, slant)
        obs = yield from face(obs, math.atan2(hand[1] - obs.xy[1], hand[0] - obs.xy[0]))
        ready = self._arm.reaching(obs, self._ahead(obs, HOLD_DISTANCE, self._height(obs)), _rotation(obs.yaw))
        obs = yield from self._arm.move(obs, ready or self._arm.named("ready"), grasp=False)
        return (yield from creep(obs, obs.distance_to(hand) - HOLD_DISTANCE))

    def _height(self, obs: Observation) -> float:
        """Returns the height of the handle, world frame, metres."""
        return obs.links[self._door.handle].position[2]

    @staticmethod
    def _ahead(obs: Observation, metres: float, z: float) -> Vec3:
        """Returns a point straight ahead of the base at height ``z``, world frame, metres."""
        return obs.xy[0] + metres * math.cos(obs.yaw), obs.xy[1] + metres * math.sin(obs.yaw), z

    def _slant(self, obs: Observation) -> float:
        """Returns the slant at which the handle is grasped; smaller for a partly open door."""
        return max(0.0, self._doorway.slant - self._door.opening(obs) / 2.0)

    def _driver(self, obs: Observation, goal: XY, near: float = 0.0) -> Driver:
        """Returns a driver to a goal that avoids the door leaf at its current opening."""
        leaf = leaf_outline(self._door, self._door.opening(obs))
        return Driver(self._doorway.ground, goal, obstacles=[leaf], near=near)

    def _grasp(self, obs: Observation) -> Steps:
        """Moves the gripper to the handle and closes it."""
        door, opening = self._door, self._door.opening(obs)
        slant = door.slant(opening, door.grip(opening, self._slant(obs)), obs.xy)
        point, rotation = (*door.grip(opening, slant), self._height(obs)), _rotation(door.towards(opening, slant) + math.pi)
        joints = self._arm.reaching(obs, point, rotation) or self._arm.reaching(obs, point)
        if joints is not None:
            obs = yield from self._arm.move(obs, joints, grasp=False, patience=_PATIENCE_S)
        for _ in range(20):
            obs = yield Action(grasp=True)
            if obs.held:
                break
        return obs

    def _pull(self, obs: Observation) -> Steps:
        """Backs up while the gripper follows the handle's arc about the hinge."""
        x, y, z = self._arm.tool(obs).position
        door, begin = self._door, self._door.opening(obs)
        radius = math.dist((x, y), door.hinge)
        ahead_of_leaf = math.atan2(y - door.hinge[1], x - door.hinge[0]) - door.bearing - door.sense * begin
        angle, rest = begin, dict(obs.joints)
        slant = door.slant(begin, door.grip(begin, self._slant(obs)), obs.xy)
        path = backing_path(door, slant, self._doorway.wide, begin)
        targets, until = rest, obs.time + 30.0
        while door.opening(obs) < self._doorway.wide and obs.held and obs.time < until:
            # Limits the lead of the target over the door.
            angle = min(angle + 0.1 * PULL_SPEED / radius, door.opening(obs) + _LEAD)
            bearing = door.bearing + ahead_of_leaf + door.sense * angle
            hand = door.hinge[0] + radius * math.cos(bearing), door.hinge[1] + radius * math.sin(bearing)
            targets = self._arm.towards_point(obs, targets, (*hand, z), rest)
            linear, angular = path.speeds((*obs.xy, obs.yaw), angle)
            obs = yield Action(linear, angular, joints=targets, grasp=True)
        return obs

    def _release(self, obs: Observation) -> Steps:
        """Relaxes the arm, opens the gripper, backs up, and folds the arm, first straight back to avoid collisions."""
        if obs.held:
            # A gripper that opens while pulling springs back against the handle and pushes the door shut.
            obs = yield from wait(obs, _RELAXES_S, Action(joints=self._arm.still(obs), grasp=True))
        obs = yield from wait(obs, 0.6, Action(grasp=False))
        obs = yield from creep(obs, -LEAVE)
        folded = self._arm.reaching(obs, self._ahead(obs, _FOLDED[0], obs.base.position[2] + _FOLDED[1]))
        if folded is not None:
            obs = yield from self._arm.move(obs, folded, patience=_PATIENCE_S)
        return (yield from self._arm.move(obs, self._arm.named("tucked")))

    def _through(self, obs: Observation) -> Steps:
        """Drives to the goal; gives up if the door is not open wide enough, so that it is opened again."""
        goal = self._episode.goal.position
        assert goal is not None
        return (yield from drive(obs, self._driver(obs, goal[:2], RADIUS - 0.05), longest=90.0, waits=False))
