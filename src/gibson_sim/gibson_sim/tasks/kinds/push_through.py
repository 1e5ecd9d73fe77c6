"""Drive through a doorway blocked by boxes; no path leads around them."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from gibson_sim.errors import SceneError
from gibson_sim.maps.paths import path_length
from gibson_sim.maps.rooms import Door
from gibson_sim.tasks.episode import Episode, Goal, Item
from gibson_sim.tasks.ground import Ground, footprint
from gibson_sim.tasks.placing import TRIES, free_place, no_room, on_floor
from gibson_sim.tasks.scripts.driving import Driver, pose_xy
from gibson_sim.tasks.task import BASELINES, Policy, Task, generator
from gibson_sim.types import Pose

RADIUS = 0.30
"""Distance to the goal within which it is reached, metres."""
MODELS = ("box_cardboard", "basket", "bin_waste", "box_small")
"""Objects that block a doorway."""
AWAY = (1.0, 3.0)
"""Minimum and maximum length of the path from the doorway to start and goal, metres."""
_BEYOND = 0.6
"""Minimum distance from the plane of the wall to start and goal, metres."""
_GAP = 0.015
"""Gap between boxes, and beside them, metres."""
_TIGHT = 0.06
"""Difference between the robot's diameter and the widest gap, metres."""
_UNEVEN, _CROOKED = 0.04, 0.05
"""Maximum offset along the passage, metres, and maximum rotation, radians, of a box from its place in the row."""


class PushThrough(Task):
    """Start and goal are on opposite sides of a doorway; the boxes in it block every path between them."""

    name = "push-through"
    environment = "PushThrough"
    about = "get through a doorway that boxes block"
    baselines = (*BASELINES, "careful")
    rewards_by_path = True

    def generate(self, seed: int, ground: Ground) -> Episode:
        """Returns the episode of a seed; see ``Task.generate``."""
        rng = generator(self, seed)
        for _ in range(TRIES):
            if not ground.doors:
                break
            door = ground.doors[int(rng.integers(len(ground.doors)))]
            try:
                start, goal = _both_sides(ground, rng, door)
                items = _blockade(ground, rng, door)
                if _open(ground, start, goal, items):
                    continue
                path = ground.space.planner.path(pose_xy(start), pose_xy(goal))
            except SceneError:
                continue
            if path_length(path) > 2.0 * sum(AWAY):
                continue
            text = f"Go through the doorway to x = {goal.position[0]:.2f} m, y = {goal.position[1]:.2f} m."
            shortest = max(path_length(path) - RADIUS, 0.1)
            return Episode(self.name, seed, start, items, Goal(text, goal.position, RADIUS), shortest, time_limit=90.0)
        raise no_room(self.name, ground, "no doorway can be blocked so that no path leads around it")

    def scripted(self, episode: Episode, ground: Ground) -> Policy:
        """Returns a driver that ignores the boxes, and backs up when it gets stuck."""
        assert episode.goal.position is not None
        return Driver(ground, episode.goal.position[:2], episode.items, around=False, near=RADIUS)

    def policy(self, baseline: str, episode: Episode, ground: Ground) -> Policy:
        """Returns a baseline for an episode; ``careful`` avoids boxes and never pushes, which shows that pushing is necessary."""
        if baseline == "careful":
            assert episode.goal.position is not None
            return Driver(ground, episode.goal.position[:2], episode.items, pushes=False, near=RADIUS)
        return super().policy(baseline, episode, ground)


def _both_sides(ground: Ground, rng: np.random.Generator, door: Door) -> tuple[Pose, Pose]:
    """Samples a start on one side of a door and a goal on the other, both near it, T_world_base."""
    distances = ground.space.planner.distances(door.center)
    rows, columns = ground.floor.shape
    centers = ground.floor.centers(np.indices((rows, columns)).transpose(1, 2, 0))
    yaw = _squared(door.yaw)
    side = (centers - door.center) @ np.array([math.cos(yaw), math.sin(yaw)])
    near = (distances >= AWAY[0]) & (distances <= AWAY[1])
    first, second = (np.asarray(near & (sign * side > _BEYOND)) for sign in rng.permutation([-1.0, 1.0]))
    return free_place(ground, rng, first), free_place(ground, rng, second)


def _blockade(ground: Ground, rng: np.random.Generator, door: Door) -> tuple[Item, ...]:
    """Returns a row of boxes that fills a doorway from side to side; an empty tuple if no boxes fit."""
    along = np.array([math.cos(_squared(door.yaw)), math.sin(_squared(door.yaw))])
    across = np.array([-along[1], along[0]])
    row: list[tuple[str, float, float]] = []
    remaining = door.width - 2.0 * _GAP
    while remaining > 2.0 * ground.robot.radius - _TIGHT:
        fitting = [box for box in _widths() if box[2] <= remaining]
        if not fitting:
            return ()
        row.append(fitting[int(rng.integers(len(fitting)))])
        remaining -= row[-1][2] + _GAP
    offset = -(sum(width for _, _, width in row) + _GAP * (len(row) - 1)) / 2.0
    items = []
    for number, (model, rotation, width) in enumerate(row, 1):
        x, y = door.center + across * (offset + width / 2.0) + along * rng.uniform(-_UNEVEN, _UNEVEN)
        yaw = _squared(door.yaw) + rotation + rng.uniform(-_CROOKED, _CROOKED)
        items.append(Item(f"box_{number}", model, on_floor(ground, float(x), float(y), float(yaw))))
        offset += width + _GAP
    return tuple(items)


def _open(ground: Ground, start: Pose, goal: Pose, items: tuple[Item, ...]) -> bool:
    """Returns whether a path leads around the boxes."""
    footprints = [footprint(item.model, item.pose) for item in items]
    return not items or ground.space.with_obstacles(footprints).connected(pose_xy(start), pose_xy(goal))


def _squared(yaw: float) -> float:
    """Returns the nearest multiple of 90 degrees: walls are axis-aligned, and the yaw of a doorway is only approximate."""
    return round(yaw / (math.pi / 2.0)) * math.pi / 2.0


@lru_cache(maxsize=1)
def _widths() -> tuple[tuple[str, float, float], ...]:
    """Returns (object, yaw in radians, width across the passage in metres) for each object and orientation."""
    sizes = {model: np.ptp(footprint(model, Pose()), axis=0).tolist() for model in MODELS}
    return tuple((model, yaw, sizes[model][axis]) for model in MODELS for yaw, axis in ((0.0, 1), (math.pi / 2.0, 0)))
