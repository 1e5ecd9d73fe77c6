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
from gibson_sim.tasks.scripts.arm import Arm, Script, Steps, creep, wait
from gibson_sim.tasks.scripts.handling import ABOVE, FINGERS, approach, downwards, drive_to_stand, ready, take_from_above
from gibson_sim.tasks.task import Policy, generator
from gibson_sim.types import Vec3

THING = "thing"
THINGS = ("can_soda", "can_food", "cup", "mug", "glass_tumbler", "candle", "fruit_apple", "fruit_orange", "remote_control")
"""Objects that fit between the fingers and are low enough to be held upright from above."""
SURFACES = ("table_side", "cabinet_drawers", "cabinet_doors")
"""Furniture with surfaces at heights of 0.50, 0.72 and 0.76 m."""
NEAR = 0.03
"""Distance from the centre of the object to its goal within which it is placed, metres."""
AT_REST = 0.02
"""Speed below which the object is at rest, m/s."""
HAND_AWAY = 0.10
"""Minimum distance from the tool to the centre of the object for success, metres: nearer, the object may lean on the gripper."""
SAME = 1.0 / 3.0
"""Fraction of episodes with start and goal on the same surface."""
FROM_EDGE = (0.10, 0.22)
"""Minimum and maximum distance from the front edge of a surface to a position on it, metres."""
TO_SIDE = 0.20
"""Maximum lateral distance from the centre of a surface to a position on it, metres; the minimum of ``FROM_EDGE`` to its sides is kept."""
APART = 0.15
"""Minimum distance between start and goal, metres."""
_OVER = 0.08
"""Clearance of the approaching gripper above the object, metres."""
_NEAREST = 0.46
"""Minimum distance from the base to a position that a downward arm can reach, metres."""
_TRIES = 3
"""Maximum number of attempts of the script."""


class PickAndPlace(ArmTask):
    """The object stands on a surface; its goal is on the same or on another surface."""

    name = "pick-and-place"
    environment = "PickAndPlace"
    about = "pick an object and place it at a goal position, to within 3 cm"

    def generate(self, seed: int, ground: Ground) -> Episode:
        """Returns the episode of a seed; see ``Task.generate``."""
        Arm(ground.robot)
        rng = generator(self, seed)
        for _ in range(TRIES // 4):
            furniture = _furniture(ground, rng)
            start = start_for(ground, rng, furniture) if furniture else None
            if start is None:
                continue
            model = THINGS[int(rng.integers(len(THINGS)))]
            positions = _start_and_goal(rng, furniture)
            if positions is None:
                continue
            position, goal = positions
            thing = item_on_point(THING, model, position, float(rng.uniform(-math.pi, math.pi)))
            kind = item_body(thing).semantic_class
            text = f"Put the {kind.replace('_', ' ')} to x = {goal[0]:.2f} m, y = {goal[1]:.2f} m, z = {goal[2]:.2f} m."
            items = (*(piece.item for piece in furniture), thing)
            return Episode(self.name, seed, start, items, Goal(text, goal, NEAR, THING, kind), math.nan, time_limit=180.0)
        raise no_room(self.name, ground, "no wall has room for a table with free floor in front of it for a robot")

    def remaining(self, episode: Episode, obs: Observation, ground: Ground) -> float:
        """Returns the distance from the object to its goal plus, until it is placed, from the gripper to the object, metres."""
        distance = _goal_distance(episode, obs)
        if distance <= NEAR:
            return distance
        return distance + math.dist(tool_position(ground, obs), item_centre(episode.items[-1], obs))

    def succeeded(self, episode: Episode, obs: Observation, ground: Ground) -> bool:
        """Returns whether the object rests at its goal and the gripper has released it."""
        thing = episode.items[-1]
        at_rest = obs.speeds.get(item_root(thing), 0.0) < AT_REST
        hand_away = math.dist(tool_position(ground, obs), item_centre(thing, obs)) > HAND_AWAY
        return not obs.held and at_rest and hand_away and _goal_distance(episode, obs) <= NEAR

    def scripted(self, episode: Episode, ground: Ground) -> Policy:
        """Returns a script that grasps the object from above, carries it, and puts it down."""
        return Script(_PickAndPlaceScript(episode, ground).steps)


def _furniture(ground: Ground, rng: np.random.Generator) -> tuple[Furniture, ...]:
    """Returns one or two pieces of furniture, the first for the object and the last for the goal; an empty tuple if there is no room."""
    count = 1 if rng.random() < SAME else 2
    furniture: list[Furniture] = []
    for number in range(count):
        model = SURFACES[int(rng.integers(len(SURFACES)))]
        piece = place_against_wall(ground, rng, f"surface_{number + 1}", model, furniture)
        if piece is None:
            return ()
        furniture.append(piece)
    return tuple(furniture)


def _start_and_goal(rng: np.random.Generator, furniture: Sequence[Furniture]) -> tuple[Vec3, Vec3] | None:
    """Samples the position of the object and its goal, world frame, metres; None if there is no room for both."""
    for _ in range(TRIES):
        first = _sample_position(rng, furniture[0])
        # On a small surface, no position is far enough from a first position near the centre.
        for _ in range(TRIES):
            second = _sample_position(rng, furniture[-1])
            if math.dist(first, second) >= APART:
                return first, second
    return None


def _sample_position(rng: np.random.Generator, furniture: Furniture) -> Vec3:
    _, high = extent(furniture.item.model)
    side = min(TO_SIDE, high[1] - FROM_EDGE[0])
    return furniture.point(high[0] - float(rng.uniform(*FROM_EDGE)), float(rng.uniform(-side, side)), high[2])


def _goal_distance(episode: Episode, obs: Observation) -> float:
    """Returns the distance from the centre of the object to its goal, metres."""
    goal, thing = episode.goal.position, episode.items[-1]
    assert goal is not None
    return math.dist(item_centre(thing, obs), (goal[0], goal[1], goal[2] + height(thing.model) / 2.0))


class _PickAndPlaceScript:
    """Picks the object and places it; tries again after a failure."""

    def __init__(self, episode: Episode, ground: Ground) -> None:
        assert episode.goal.position is not None
        self._episode, self._ground, self._arm = episode, ground, Arm(ground.robot)
        self._thing, self._goal = episode.items[-1], episode.goal.position
        self._furniture = tuple(furniture_of(item) for item in episode.items[:-1])

    def steps(self, obs: Observation) -> Steps:
        """Yields the actions of the whole script."""
        for _ in range(_TRIES):
            source = min(self._furniture, key=lambda piece: math.dist(piece.item.pose.position, item_centre(self._thing, obs)))
            obs = yield from self._approach(obs, source, False)
            obs = yield from take_from_above(obs, self._arm, self._thing, ABOVE + 0.05)
            if obs.held == THING:
                if source is not self._furniture[-1]:
                    obs = yield from creep(obs, -REACHING, grasp=True)
                    obs = yield from self._approach(obs, self._furniture[-1], True)
                obs = yield from self._put_down(obs)
            obs = yield from creep(obs, -REACHING, grasp=False)
            if _goal_distance(self._episode, obs) <= NEAR:
                break
        return obs

    def _approach(self, obs: Observation, furniture: Furniture, grasp: bool) -> Steps:
        """Drives to a surface, and holds the gripper above it."""
        obs = yield from drive_to_stand(obs, self._ground, furniture, self._furniture, grasp)
        top = furniture.point(*extent(furniture.item.model)[1])[2]
        obs = yield from ready(obs, self._arm, top + height(self._thing.model) + _OVER, downwards(obs), grasp, low=top + FINGERS)
        return (yield from approach(obs, furniture, STAND - REACHING, grasp))

    def _put_down(self, obs: Observation) -> Steps:
        """Lowers the object to its goal, and opens the gripper."""
        ahead, _ = obs.in_base(self._goal[:2])
        if ahead < _NEAREST:
            obs = yield from creep(obs, ahead - _NEAREST, grasp=True)
        rotation = downwards(obs)
        # Twice above the goal: the object may have rotated slightly in the gripper.
        for up, speed in ((0.05, 0.15), (0.05, 0.15), (0.003, 0.06)):
            obs = yield from self._arm.straight(obs, self._tool_above_goal(obs, up), rotation, True, speed)
        obs = yield from wait(obs, 1.0, Action(grasp=False))
        x, y, z = self._arm.tool(obs).position
        return (yield from self._arm.straight(obs, (x, y, z + ABOVE + height(self._thing.model)), rotation, False, speed=0.08))

    def _tool_above_goal(self, obs: Observation, up: float) -> Vec3:
        """Returns the tool position for which the object is ``up`` metres above its goal, world frame, metres."""
        tool, thing = self._arm.tool(obs).position, item_centre(self._thing, obs)
        x, y, z = ((g + t - m) for g, t, m in zip(self._goal, tool, thing, strict=True))
        return x, y, z + height(self._thing.model) / 2.0 + up
