"""Open a door by its handle, and go through the doorway."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gibson_sim.tasks.episode import Action, Episode, Goal, Item, View, item_body
from gibson_sim.tasks.ground import Ground
from gibson_sim.tasks.placing import free_place, no_room, on_floor
from gibson_sim.tasks.scripts.arm import Arm, Script, Steps, creep, drive, face, pointing, wait
from gibson_sim.tasks.scripts.doors import (
    LEAVE,
    PULL_SPEED,
    REACH,
    XY,
    DoorChange,
    Doorway,
    HingedDoor,
    backing_way,
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
"""The doorway of scene ``arena``, in which no door hangs: x of the middle of its wall, y of its two sides, metres."""
HINGE_INSIDE = 0.022
"""Metres from a jamb to the hinge, see docs/objects.md."""
OPEN = math.radians(60.0)
"""A door that is open wider counts as open."""
RADIUS = 0.40
"""Metres: so near to the goal is there."""
HANDLE_HEIGHTS = (0.92, 1.10)
"""Metres above the floor."""
DAMPINGS = (1.0, 5.0)
"""Of hinges, N m s/rad."""
FRICTIONS = (0.2, 2.0)
"""Of hinges, N m."""
HANDLE_FRICTIONS = (0.3, 0.6)
"""Coefficients of handles."""
_LEAD = 0.07
"""Radians that the hand may be ahead of the door: the arm is stiff, and more tears the hand off."""
_FARTHER = 0.3
"""Metres behind the place where it takes the handle, at which it unfolds its arm."""
_PATIENCE_S = 2.5
"""So long the arm may take for a small movement."""
_RELAXES_S = 0.5
"""Seconds that it holds still before it lets go."""
_FOLDED = (0.42, 0.95)
"""Metres before the base and above the floor, where the hand is on its way to be tucked in."""
_TRIES = 3
"""Times that it takes the handle anew where it lost it."""


class OpenDoor(Task):
    """The door is closed and opens towards the robot, its hinge left or right."""

    name = "open-door"
    environment = "OpenDoor"
    about = "open a door by its handle and go through; it opens towards the robot"
    scene = "arena"
    robot = "arm_bot"

    def generate(self, seed: int, ground: Ground) -> Episode:
        """Returns the episode of a seed; see ``Task.generate``."""
        rng = generator(self, seed)
        body, model, pose = self._hung(ground, rng)
        values = [float(rng.uniform(*span)) for span in (HANDLE_HEIGHTS, DAMPINGS, FRICTIONS, HANDLE_FRICTIONS)]
        text = changed_door(item_body(Item(DOOR, model, pose)).model.path, DoorChange(*values))
        others = {other.name for other in ground.scene.bodies} - {body}
        name = next(name for name in (DOOR, *(f"{DOOR}_{k}" for k in range(2, len(others) + 3))) if name not in others)
        item, removed = Item(name, model, pose, text), (body,) if body else ()
        there = doorway(ground, item_door(item), removed)
        if there is None:
            raise no_room(self.name, ground, "no door that a robot has the room to pull open")
        start, goal = (free_place(there.ground, rng, region) for region in (there.near, there.far))
        words = f"Open the door and go through it to x = {goal.position[0]:.2f} m, y = {goal.position[1]:.2f} m."
        aim = Goal(words, goal.position, RADIUS, name, "door")
        return Episode(self.name, seed, start, (item,), aim, math.nan, time_limit=120.0, removed=removed)

    def _hung(self, ground: Ground, rng: np.random.Generator) -> tuple[str, str, Pose]:
        """Returns which body of the scene is replaced (empty = none), the model of a door, and where it hangs."""
        if ground.scene.name == "arena":
            # The robot is before the wall (side -1) or behind it, the hinge to its left or to its right.
            side, left = (-1.0, 1.0)[int(rng.integers(2))], bool(rng.integers(2))
            hinge_high = left == (side < 0)
            y = JAMBS[1] - HINGE_INSIDE if hinge_high else JAMBS[0] + HINGE_INSIDE
            yaw = -math.pi / 2.0 if hinge_high else math.pi / 2.0
            # A left door opens to +y of its own frame, which has to be the robot's side.
            opens_left = -math.sin(yaw) * side > 0.0
            return "", "door_90_left" if opens_left else "door_90_right", on_floor(ground, WALL_X, y, yaw)
        doors = scene_doors(ground.scene)
        shuffled = (doors[k].body for k in rng.permutation(len(doors)) if doorway(ground, doors[k], (doors[k].body,)) is not None)
        name = next(shuffled, "")
        if not name:
            raise no_room(self.name, ground, "no door that a robot has the room to pull open, and no other way round")
        body = next(body for body in ground.scene.bodies if body.name == name)
        return name, str(body.model.path), body.start

    def remaining(self, episode: Episode, view: View, ground: Ground) -> float:
        """Returns the straight distance to the goal, metres, and how far the door is from being open, radians, added up."""
        return super().remaining(episode, view, ground) + max(0.0, OPEN - opening(episode, view))

    def succeeded(self, episode: Episode, view: View, ground: Ground) -> bool:
        """Returns whether the base is at the goal, and the door open."""
        return super().succeeded(episode, view, ground) and opening(episode, view) > OPEN

    def scripted(self, episode: Episode, ground: Ground) -> Policy:
        """Returns who takes the handle, pulls the door open by backing up, and drives through."""
        there = doorway(ground, episode_door(episode), episode.removed)
        assert there is not None, episode
        return Script(_Opener(episode, there).steps)


@lru_cache(maxsize=64)
def item_door(item: Item) -> HingedDoor:
    """Returns the door that an item is."""
    door = hinged_door(item_body(item))
    assert door is not None, item.model
    return door


def episode_door(episode: Episode) -> HingedDoor:
    """Returns the door that an episode is about."""
    return item_door(episode.items[0])


def opening(episode: Episode, view: View) -> float:
    """Returns how far the door is open, radians."""
    return episode_door(episode).opening(view)


def _rotation(yaw: float) -> NDArray[np.float64]:
    """Returns the axes of a hand that points in a direction and closes from above and below, as for a lever."""
    return pointing((math.cos(yaw), math.sin(yaw), 0.0), (0.0, 0.0, 1.0))


class _Opener:
    def __init__(self, episode: Episode, there: Doorway) -> None:
        self._episode, self._there, self._door = episode, there, there.door
        self._arm = Arm(there.ground.robot)

    def steps(self, view: View) -> Steps:
        """Goes before the handle, takes it, pulls, lets go, goes through."""
        for _ in range(_TRIES):
            view = yield from self._before_handle(view)
            view = yield from self._take(view)
            view = yield from self._pull(view)
            view = yield from self._let_go(view)
            if self._door.opening(view) > OPEN:
                view = yield from self._through(view)
        return view

    def _before_handle(self, view: View) -> Steps:
        """Stands before the handle, the arm ready."""
        door, opening, slant = self._door, self._door.opening(view), self._slant(view)
        place = door.stance(opening, slant, REACH + _FARTHER)
        if view.distance_to(place) > 0.1:
            view = yield from drive(view, self._driver(view, place))
        hand = door.grip(opening, slant)
        view = yield from face(view, math.atan2(hand[1] - view.xy[1], hand[0] - view.xy[0]))
        ready = self._arm.reaching(view, self._ahead(view, REACH, self._height(view)), _rotation(view.yaw))
        view = yield from self._arm.move(view, ready or self._arm.named("ready"), grasp=False)
        return (yield from creep(view, view.distance_to(hand) - REACH))

    def _height(self, view: View) -> float:
        """Returns that of the handle, world."""
        return view.links[self._door.handle].position[2]

    @staticmethod
    def _ahead(view: View, metres: float, z: float) -> Vec3:
        """Returns a point straight ahead of the base, at a height of the world."""
        return view.xy[0] + metres * math.cos(view.yaw), view.xy[1] + metres * math.sin(view.yaw), z

    def _slant(self, view: View) -> float:
        """Returns the slant under which the handle is taken: of a door that is open already, what is left of the whole swing."""
        return max(0.0, self._there.slant - self._door.opening(view) / 2.0)

    def _driver(self, view: View, place: XY, near: float = 0.0) -> Driver:
        """Returns who drives to a place, the leaf of the door being in the way as it stands now."""
        leaf = leaf_outline(self._door, self._door.opening(view))
        return Driver(self._there.ground, place, obstacles=[leaf], near=near)

    def _take(self, view: View) -> Steps:
        """Brings the hand to the handle and closes it."""
        door, opening = self._door, self._door.opening(view)
        slant = door.slant(opening, door.grip(opening, self._slant(view)), view.xy)
        point, rotation = (*door.grip(opening, slant), self._height(view)), _rotation(door.towards(opening, slant) + math.pi)
        joints = self._arm.reaching(view, point, rotation) or self._arm.reaching(view, point)
        if joints is not None:
            view = yield from self._arm.move(view, joints, grasp=False, patience=_PATIENCE_S)
        for _ in range(20):
            view = yield Action(grasp=True)
            if view.held:
                break
        return view

    def _pull(self, view: View) -> Steps:
        """Backs up while the hand follows the handle's way about the hinge."""
        x, y, z = self._arm.tool(view).position
        door, begin = self._door, self._door.opening(view)
        radius = math.dist((x, y), door.hinge)
        ahead_of_leaf = math.atan2(y - door.hinge[1], x - door.hinge[0]) - door.bearing - door.sense * begin
        angle, rest = begin, dict(view.joints)
        way = backing_way(door, door.slant(begin, door.grip(begin, self._slant(view)), view.xy), self._there.wide, begin)
        told, until = rest, view.time + 30.0
        while door.opening(view) < self._there.wide and view.held and view.time < until:
            # The hand may not run away from the door.
            angle = min(angle + 0.1 * PULL_SPEED / radius, door.opening(view) + _LEAD)
            at = door.bearing + ahead_of_leaf + door.sense * angle
            hand = door.hinge[0] + radius * math.cos(at), door.hinge[1] + radius * math.sin(at)
            told = self._arm.leaning(view, told, (*hand, z), rest)
            linear, angular = way.speeds((*view.xy, view.yaw), angle)
            view = yield Action(linear, angular, joints=told, grasp=True)
        return view

    def _let_go(self, view: View) -> Steps:
        """Lets the arm relax, opens the hand, backs away, and folds the arm: first straight back, so that it knocks at nothing."""
        if view.held:
            # A hand that lets go while it pulls springs back against the handle, and the door swings shut.
            view = yield from wait(view, _RELAXES_S, Action(joints=self._arm.still(view), grasp=True))
        view = yield from wait(view, 0.6, Action(grasp=False))
        view = yield from creep(view, -LEAVE)
        folded = self._arm.reaching(view, self._ahead(view, _FOLDED[0], view.base.position[2] + _FOLDED[1]))
        if folded is not None:
            view = yield from self._arm.move(view, folded, patience=_PATIENCE_S)
        return (yield from self._arm.move(view, self._arm.named("tucked")))

    def _through(self, view: View) -> Steps:
        """Drives to the goal; a door that is not open wide enough for it has to be opened anew."""
        goal = self._episode.goal.position
        assert goal is not None
        return (yield from drive(view, self._driver(view, goal[:2], RADIUS - 0.05), longest=90.0, waits=False))
