"""Pick an object and place it at a goal position."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gibson_sim.tasks.episode import Action, Episode, Goal, Observation, item_body, item_root
from gibson_sim.tasks.furnishing import (
    REACHING,
    STAND,
    Furniture,
    against_a_wall,
    extent,
    height,
    lying,
    middle,
    standing,
    start_before,
)
from gibson_sim.tasks.ground import Ground
from gibson_sim.tasks.kinds.arm_task import ArmTask, tool_position
from gibson_sim.tasks.placing import TRIES, no_room
from gibson_sim.tasks.scripts.arm import Arm, Script, Steps, creep, wait
from gibson_sim.tasks.scripts.handling import ABOVE, FINGERS, come_near, downwards, go_before, ready, take_from_above
from gibson_sim.tasks.task import Policy, generator
from gibson_sim.types import Vec3

THING = "thing"
THINGS = ("can_soda", "can_food", "cup", "mug", "glass_tumbler", "candle", "fruit_apple", "fruit_orange", "remote_control")
"""Objects that fit between the fingers and are low enough to be held upright from above."""
SURFACES = ("table_side", "cabinet_drawers", "cabinet_doors")
"""Furniture with surfaces at 0.50, 0.72 and 0.76 m."""
NEAR = 0.03
"""Distance from the centre of the object to its goal within which it is placed, metres."""
AT_REST = 0.02
"""Speed below which the object is at rest, m/s."""
HAND_AWAY = 0.10
"""Distance from the tool to the centre of the object below which the object may still lean on the gripper, metres."""
SAME = 1.0 / 3.0
"""Fraction of episodes in which both places are on the same surface."""
FROM_EDGE = (0.10, 0.22)
"""Least and greatest distance from the front edge of a surface to a place on it, metres."""
TO_SIDE = 0.20
"""Greatest sideways distance from the centre of a surface to a place on it, metres; ``FROM_EDGE`` from its sides is kept."""
APART = 0.15
"""Least distance between both places, metres."""
_OVER = 0.08
"""Clearance of the approaching gripper above the object, metres."""
_NEAREST = 0.46
"""Distance from the base to a place below which an arm that points down does not reach it, metres."""
_TRIES = 3
"""Attempts of the script."""


class PickAndPlace(ArmTask):
    """The object stands on a surface, and its goal is on another one or on the same."""

    name = "pick-and-place"
    environment = "PickAndPlace"
    about = "pick an object and place it at a goal position, to within 3 cm"

    def generate(self, seed: int, ground: Ground) -> Episode:
        """Returns the episode of a seed; see ``Task.generate``."""
        Arm(ground.robot)
        rng = generator(self, seed)
        for _ in range(TRIES // 4):
            furniture = _furniture(ground, rng)
            start = start_before(ground, rng, furniture) if furniture else None
            if start is None:
                continue
            model = THINGS[int(rng.integers(len(THINGS)))]
            places = _places(rng, furniture)
            if places is None:
                continue
            place, goal = places
            thing = lying(THING, model, place, float(rng.uniform(-math.pi, math.pi)))
            kind = item_body(thing).semantic_class
            text = f"Put the {kind.replace('_', ' ')} to x = {goal[0]:.2f} m, y = {goal[1]:.2f} m, z = {goal[2]:.2f} m."
            items = (*(one.item for one in furniture), thing)
            return Episode(self.name, seed, start, items, Goal(text, goal, NEAR, THING, kind), math.nan, time_limit=180.0)
        raise no_room(self.name, ground, "no wall has a table before it with free floor for a robot")

    def remaining(self, episode: Episode, obs: Observation, ground: Ground) -> float:
        """Returns the distance from the object to its goal plus, until it is placed, from the gripper to the object, metres."""
        away = _away(episode, obs)
        return away if away <= NEAR else away + math.dist(tool_position(ground, obs), middle(episode.items[-1], obs))

    def succeeded(self, episode: Episode, obs: Observation, ground: Ground) -> bool:
        """Returns whether the object rests at its goal and the gripper has released it."""
        thing = episode.items[-1]
        rests = obs.speeds.get(item_root(thing), 0.0) < AT_REST
        away = math.dist(tool_position(ground, obs), middle(thing, obs)) > HAND_AWAY
        return not obs.held and rests and away and _away(episode, obs) <= NEAR

    def scripted(self, episode: Episode, ground: Ground) -> Policy:
        """Returns a script that grasps the object from above, carries it, and puts it down."""
        return Script(_PickAndPlaceScript(episode, ground).steps)


def _furniture(ground: Ground, rng: np.random.Generator) -> tuple[Furniture, ...]:
    """Returns one or two pieces of furniture, the first with the object and the last with the goal; none if there is no room."""
    count = 1 if rng.random() < SAME else 2
    found: list[Furniture] = []
    for number in range(count):
        model = SURFACES[int(rng.integers(len(SURFACES)))]
        one = against_a_wall(ground, rng, f"surface_{number + 1}", model, found)
        if one is None:
            return ()
        found.append(one)
    return tuple(found)


def _places(rng: np.random.Generator, furniture: Sequence[Furniture]) -> tuple[Vec3, Vec3] | None:
    """Returns where the object stands and its goal, world frame, metres; None if there is no room for both."""
    for _ in range(TRIES):
        first = _place(rng, furniture[0])
        # On a small surface nothing is far enough from its centre.
        for _ in range(TRIES):
            second = _place(rng, furniture[-1])
            if math.dist(first, second) >= APART:
                return first, second
    return None


def _place(rng: np.random.Generator, one: Furniture) -> Vec3:
    _, high = extent(one.item.model)
    side = min(TO_SIDE, high[1] - FROM_EDGE[0])
    return one.point(high[0] - float(rng.uniform(*FROM_EDGE)), float(rng.uniform(-side, side)), high[2])


def _away(episode: Episode, obs: Observation) -> float:
    """Returns the distance from the centre of the object to its goal, metres."""
    goal, thing = episode.goal.position, episode.items[-1]
    assert goal is not None
    return math.dist(middle(thing, obs), (goal[0], goal[1], goal[2] + height(thing.model) / 2.0))


class _PickAndPlaceScript:
    """Picks the object and places it; tries again if that failed."""

    def __init__(self, episode: Episode, ground: Ground) -> None:
        assert episode.goal.position is not None
        self._episode, self._ground, self._arm = episode, ground, Arm(ground.robot)
        self._thing, self._goal = episode.items[-1], episode.goal.position
        self._every = tuple(standing(item) for item in episode.items[:-1])

    def steps(self, obs: Observation) -> Steps:
        """Yields the actions of the whole script."""
        for _ in range(_TRIES):
            source = min(self._every, key=lambda one: math.dist(one.item.pose.position, middle(self._thing, obs)))
            obs = yield from self._before(obs, source, False)
            obs = yield from take_from_above(obs, self._arm, self._thing, ABOVE + 0.05)
            if obs.held == THING:
                if source is not self._every[-1]:
                    obs = yield from creep(obs, -REACHING, grasp=True)
                    obs = yield from self._before(obs, self._every[-1], True)
                obs = yield from self._put(obs)
            obs = yield from creep(obs, -REACHING, grasp=False)
            if _away(self._episode, obs) <= NEAR:
                break
        return obs

    def _before(self, obs: Observation, one: Furniture, grasp: bool) -> Steps:
        """Drives before a surface, and holds the gripper above it."""
        obs = yield from go_before(obs, self._ground, one, self._every, grasp)
        top = one.point(*extent(one.item.model)[1])[2]
        obs = yield from ready(obs, self._arm, top + height(self._thing.model) + _OVER, downwards(obs), grasp, low=top + FINGERS)
        return (yield from come_near(obs, one, STAND - REACHING, grasp))

    def _put(self, obs: Observation) -> Steps:
        """Lowers the object to its goal, and opens the gripper."""
        ahead, _ = obs.in_base(self._goal[:2])
        if ahead < _NEAREST:
            obs = yield from creep(obs, ahead - _NEAREST, grasp=True)
        rotation = downwards(obs)
        # Twice above it: the object may have turned a little in the gripper.
        for up, speed in ((0.05, 0.15), (0.05, 0.15), (0.003, 0.06)):
            obs = yield from self._arm.straight(obs, self._over(obs, up), rotation, True, speed)
        obs = yield from wait(obs, 1.0, Action(grasp=False))
        x, y, z = self._arm.tool(obs).position
        return (yield from self._arm.straight(obs, (x, y, z + ABOVE + height(self._thing.model)), rotation, False, speed=0.08))

    def _over(self, obs: Observation, up: float) -> Vec3:
        """Returns the tool position that puts the object ``up`` metres above its goal, world frame, metres."""
        tool, thing = self._arm.tool(obs).position, middle(self._thing, obs)
        x, y, z = ((g + t - m) for g, t, m in zip(self._goal, tool, thing, strict=True))
        return x, y, z + height(self._thing.model) / 2.0 + up
